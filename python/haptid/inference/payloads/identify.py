"""Payload identification: mass, centre of mass and inertia of bodies fixed to links, and drive gains from known masses.

Logs of the bare device and logs with each payload are fitted at once. A payload adds ten unknowns in the frame of its
link; what is known of it (its mass on a scale, say) takes unknowns away. A known mass also makes the scale of torque
identifiable, hence the gain of every motor that the mass loads (Gautier and Briot 2014, ASME Journal of Dynamic
Systems, Measurement, and Control 136(5)); its centre of mass and inertia may be unknown and are then estimated too.
Payloads as increments of inertial parameters: Khalil, Gautier and Lemoine (2007), IEEE ICRA; Gaz and De Luca (2017),
IEEE/RSJ IROS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import INERTIAL
from haptid.device.parameters import INERTIAL_UNITS
from haptid.device.parts import Joint
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.static import StaticModel, static_model
from haptid.errors import (
    ConvergenceError,
    IdentifiabilityError,
    SettingError,
    SharedRowsError,
    listed,
    unknown_name,
)
from haptid.inference.payloads.body import FIGURE_UNITS, FIGURES, AttachedBody, body_figures, nearest_body
from haptid.inference.payloads.estimates import DriveGains, PayloadEstimate, PayloadIdentification
from haptid.inference.payloads.fit import JointFit, LoadedRows, joint_fit
from haptid.inference.payloads.layout import Layout, embedding, payload_model, removed
from haptid.inference.payloads.links import body_links, link_notes
from haptid.motion.holds import Poses
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation, concatenated, observe
from haptid.observation.plan import shared_block
from haptid.observation.static import observe_poses
from haptid.uncertainty.quantities import Quantities

# Largest relative standard error of a gain: a motor that the payload loads less is left out.
LARGEST_GAIN_SE = 0.2
# Relative step of the differences by which a body's figures are differentiated.
_STEP = 1e-6
# Share of a gradient along undetermined directions up to which a figure counts as determined.
_BLIND = 1e-5

Recorded = Motion | Poses


def identify_payloads(
    model: DynamicModel,
    bare: Recorded | Sequence[Recorded],
    loaded: Sequence[tuple[AttachedBody, Recorded | Sequence[Recorded]]],
    *,
    gains: bool = False,
    shared_friction: bool = False,
) -> PayloadIdentification:
    """Identify payloads from recordings without and with them; on request the drive gains too.

    All rows are fitted at once, each motor's weighted by its residual; intervals are cluster-robust over the time
    blocks, or poses, of all recordings, so that they have the uncertainty of the bare device's parameters and of each
    loaded recording. From poses only mass and first moments are identifiable.

    Args:
        model: the dynamic model; load-dependent friction at its constants.
        bare: motions or poses of the bare device.
        loaded: payloads, and their motions or poses.
        gains: whether the drive gains are unknown. The mass of a payload must then be known. Motors whose gain the
            known masses do not determine are left out, rows and all.
        shared_friction: whether friction is the same with and without payload; otherwise it is estimated once for each
            load.

    Raises:
        SettingError: no recording without payload or none with one, names of payloads recur, gains without a known
            mass, or motions together with poses.
        UnknownNameError: there is no such link.
        SharedRowsError: a recording is given twice.
        IdentifiabilityError: gains are unknown, and the payloads determine none.
        ConvergenceError: the search for gains did not converge.
    """
    bare_data, load_data = _many(bare), [(body, _many(data)) for body, data in loaded]
    bodies = [body for body, _ in load_data]
    _check(model, bare_data, load_data, gains)
    static = any(isinstance(recording, Poses) for recording in bare_data)
    own = static_model(model) if static else model
    carrying = {body.link for body in bodies} | {*body_links(model)}
    wide = payload_model(model, sorted(carrying, key=model.device.joint_names.index))
    wide = static_model(wide) if static else wide
    to_wide = embedding(own, wide)
    observations = [_observed(wide, data) for data in (bare_data, *(data for _, data in load_data))]
    _check_shared(observations)
    layout = Layout.of(own, wide, to_wide, bodies, shared_friction)
    rows = [LoadedRows(o, *layout.affine(k)) for k, o in enumerate(observations)]
    fit, left_out = _fitted(rows, observations[0], gains)
    payloads = [_payload(wide, body, fit, layout.columns(k), static) for k, body in enumerate(bodies)]
    tested = link_notes(own, wide, layout, bodies, observations, fit)
    notes = [removed(model, bodies) if wide is not own else "", *tested]
    labels = [observations[0].motors[k].label for k in fit.motors]
    size = [motor.rows.sum() for motor in fit.rows.motors]
    unknowns = np.append(fit.x, np.zeros(len(fit.gains)))
    rms = [m.residual(unknowns) / np.sqrt(max(n, 1)) for m, n in zip(fit.rows.motors, size, strict=True)]
    return PayloadIdentification(
        model=model,
        payloads=tuple(payloads),
        gains=_gains(fit, observations[0], left_out) if gains else None,
        base=_base(own, fit, layout),
        residual={label: float(value) for label, value in zip(labels, rms, strict=True)},
        notes=tuple(filter(None, notes)),
    )


def _many(data: Recorded | Sequence[Recorded]) -> tuple[Recorded, ...]:
    return (data,) if isinstance(data, Motion | Poses) else tuple(data)


def _check(
    model: DynamicModel,
    bare: Sequence[Recorded],
    loaded: Sequence[tuple[AttachedBody, Sequence[Recorded]]],
    gains: bool,
) -> None:
    """Raise SettingError or UnknownNameError for what cannot be a payload identification."""
    if not bare or not loaded or not all(data for _, data in loaded):
        raise SettingError(
            "payloads are identified from at least one recording without payload and one with each.",
            where="loaded" if bare else "bare",
            advice="Record the same motion with and without.",
        )
    names = [body.name for body, _ in loaded]
    for body, _ in loaded:
        if body.link not in model.device.joint_names:
            message = f"payload {body.name}: the device has no link {body.link!r}."
            raise unknown_name(message, body.link, model.device.joint_names, "link")
        if names.count(body.name) > 1:
            raise SettingError(f"two payloads have the name {body.name!r}.", where=body.name, advice="Rename one.")
    kinds = {isinstance(recording, Poses) for data in (bare, *(data for _, data in loaded)) for recording in data}
    if len(kinds) > 1:
        raise SettingError(
            "motions and poses are mixed: the base parameters of poses are not those of motions.",
            where="loaded",
            advice="Identify from the motions, or from the poses.",
        )
    if gains and not any(body.mass is not None for body, _ in loaded):
        raise SettingError(
            "drive gains are unknown, and so is the mass of every payload: torque and mass scale together.",
            where="gains",
            advice="Weigh a payload and give its mass.",
        )


def _observed(model: DynamicModel, data: Sequence[Recorded]) -> Observation:
    motions = [recording for recording in data if isinstance(recording, Motion)]
    if motions:
        return observe(model, *motions)
    assert isinstance(model, StaticModel)
    return concatenated(observe_poses(model, recording) for recording in data if isinstance(recording, Poses))


def _check_shared(observations: Sequence[Observation]) -> None:
    block = shared_block(observation.blocks for observation in observations)
    if block is not None:
        raise SharedRowsError(
            f"{block.start:.3f} to {block.stop:.3f} s of log {block.log[:12]} are given for two loads.",
            where=block.log,
            found=(block.start, block.stop),
            advice="Give each recording once.",
        )


def _fitted(rows: Sequence[LoadedRows], like: Observation, gains: bool) -> tuple[JointFit, tuple[str, ...]]:
    """The fit, and sentences on motors left out because their gain is not determined."""
    motors = [k for k in range(len(like.motors)) if all(load.observation.motors[k].rows.sum() for load in rows)]
    without = [like.motors[k].label for k in range(len(like.motors)) if k not in motors]
    notes = [f"{label} is left out: a recording has no rows of it." for label in without]
    if not gains:
        return joint_fit(rows, motors, ()), tuple(notes)
    # A motor whose gain is free and undetermined does not determine the others' scale, so its rows are left out too.
    while motors:
        # The null space is that of a step from the file's gains; standard errors are those of the converged fit.
        try:
            fit = joint_fit(rows, motors, motors)
        except ConvergenceError:  # a gain that nothing holds drifts away
            fit = None
        if fit is not None:
            se = np.sqrt(np.maximum(np.diag(fit.spread(fit.of_gains()).covariance), 0.0))
            se[~fit.determined(fit.of_gains())] = np.inf
            if se.max() <= LARGEST_GAIN_SE:
                return fit, tuple(notes)
            worst = int(np.argmax(se))
            size = "" if np.isinf(se[worst]) else f" (standard error {100 * se[worst]:.0f} %)"
        else:
            worst, size = _least_loaded(rows, motors), ""
        label = like.motors[motors.pop(worst)].label
        notes.append(f"{label} is left out: the known masses do not determine its gain{size}; they load it too little.")
    raise IdentifiabilityError(
        "the known masses determine the gain of no motor.",
        found=0,
        limit=1,
        advice="Use a heavier payload, farther out, in poses where it loads the motors; or record longer.",
    )


def _least_loaded(rows: Sequence[LoadedRows], motors: Sequence[int]) -> int:
    """Position in `motors` of the one whose torque the known part of the payloads changes least."""
    shares = []
    for k in motors:
        known = total = 0.0
        for load in rows:
            motor = load.observation.motors[k]
            known += float(np.linalg.norm(motor.whole[:, :-1] @ load.m[motor.columns]) ** 2)
            total += motor.norm**2
        shares.append(known / total)
    return int(np.argmin(shares))


def _gains(fit: JointFit, like: Observation, left_out: tuple[str, ...]) -> DriveGains:
    labels = tuple(like.motors[k].label for k in fit.gains)
    quantities, factor = fit.spread(fit.of_gains()), np.exp(fit.theta)
    quantities = replace(quantities, covariance=quantities.covariance * np.outer(factor, factor))
    return DriveGains(quantities.quantities(labels, ("1",) * len(labels), factor), left_out)


def _padded(rows: Array, fit: JointFit, columns: np.ndarray) -> Array:
    """Combinations of a payload's unknowns as combinations of all, (q, unknowns + gains)."""
    padded = np.zeros((len(rows), len(fit.scale)))
    padded[:, columns] = rows
    return padded


def _base(own: DynamicModel, fit: JointFit, layout: Layout) -> Quantities:
    """Base parameters of the bare device that the rows determine."""
    p = len(layout.varying)
    rows = np.eye(len(fit.scale))[:p]
    known = np.flatnonzero(fit.determined(rows))
    names, units = ([labels[k] for k in known] for labels in (own.base.names, own.base.units))
    return fit.spread(rows[known]).quantities(names, units, fit.x[known])


def _payload(
    model: DynamicModel, body: AttachedBody, fit: JointFit, place: tuple[np.ndarray, Array, Array], static: bool
) -> PayloadEstimate:
    """One payload, as far as the fit determines it."""
    columns, offset, basis = place
    joint = model.device.joints[model.device.joint_names.index(body.link)]
    phi = offset + basis @ fit.x[columns]
    moving = basis.any(axis=1) if basis.size else np.zeros(10, dtype=bool)
    ways = _padded(basis, fit, columns)
    known = fit.determined(ways) | ~moving
    shown = np.flatnonzero(known & moving)
    names, units = [INERTIAL[k] + body.link for k in shown], [INERTIAL_UNITS[k] for k in shown]
    parameters = fit.spread(ways[shown]).quantities(names, units, phi[shown])
    figures, determined = _figures(body, joint, phi, basis, fit, columns, bool(known[9]))
    consistent = nearest_body(joint, phi, offset, basis, fit, columns, determined) if known[9] else None
    return PayloadEstimate(body, parameters, figures, _left_out(body, known, determined, static), consistent)


def _figures(
    body: AttachedBody,
    joint: Joint,
    phi: Array,
    basis: Array,
    fit: JointFit,
    columns: np.ndarray,
    mass_known: bool,
) -> tuple[Quantities, np.ndarray]:
    """The figures that are determined and were not given, and which are determined, (10,), bool."""
    nothing = Quantities((), (), np.zeros(0), np.zeros((0, 0)), np.zeros(0))
    if not mass_known or phi[9] == 0:
        return nothing, np.zeros(10, dtype=bool)
    size = np.array([max(abs(phi[:6]).max(), 1e-6)] * 6 + [max(abs(phi[6:9]).max(), 1e-6)] * 3 + [abs(phi[9])])
    step = _STEP * size
    gradient = np.column_stack(
        [
            (body_figures(joint, phi + step * unit) - body_figures(joint, phi - step * unit)) / (2 * step @ unit)
            for unit in np.eye(10)
        ]
    )
    ways = _padded(gradient @ basis, fit, columns)
    own = ways / fit.scale
    # Measured against the size of the parameters: differences leave rounding in the gradient.
    hidden = np.linalg.norm(own @ fit.null, axis=1)
    norms = np.linalg.norm(np.abs(gradient) @ np.abs(basis) / fit.scale[columns], axis=1) if basis.size else 0.0
    determined = np.asarray(hidden <= _BLIND * np.maximum(norms, 1e-300))
    is_given = np.zeros(10, dtype=bool)
    is_given[0], is_given[1:4], is_given[4:] = body.mass is not None, body.com is not None, body.inertia is not None
    shown = np.flatnonzero(determined & ~is_given)
    names, units = [FIGURES[k] for k in shown], [FIGURE_UNITS[k] for k in shown]
    return fit.spread(ways[shown]).quantities(names, units, body_figures(joint, phi)[shown]), determined


def _left_out(body: AttachedBody, known: np.ndarray, determined: np.ndarray, static: bool) -> tuple[str, ...]:
    """Sentences on what the rows do not determine."""
    lost = [INERTIAL[k] + body.link for k in np.flatnonzero(~known)]
    if not lost:
        return ()
    inertia = not known[:6].any()
    if static and inertia:
        rest = [name for name in lost if name[: len(name) - len(body.link)] in ("MX", "MY", "MZ", "M")]
        others = f", nor {listed(rest)}" if rest else ""
        return (f"Poses do not determine the inertia of {body.name}{others}: record motions for it.",)
    figures = [FIGURES[k] for k in np.flatnonzero(~determined)]
    shown = f", hence not {listed(figures)}" if figures else ""
    return (f"These recordings do not determine {listed(lost)} of {body.name}{shown}.",)
