"""Search for settings of a compensation that a hand can hold: felt mass against added damping, with three verdicts.

Each point of the search is a filter, a share of the mass and a damper at the handle. Its verdicts, at every pose:

- passive: no hand whatever gets energy (Colgate and Schenkel 1997; see `sampled`). For a mass feedforward through one
  filter of time constant t this takes physical damping of about share * mass / t.
- stable: stable with every hand of a set (Hulin, Albu-Schaeffer and Hirzinger 2014, IEEE Trans. Control Systems
  Technology 22(4), 1297-1309, who find the same gap between both for virtual walls).
- quiet: in no motion that a person makes on purpose does the hand get net energy while dry friction is on. A sine of
  speed v loses the mean power 2 Fc v / pi to dry friction Fc and Re Z v^2 / 2 to the rest, so that

      Re Z(w) + 4 Fc / (pi v(w)) > 0

  for the greatest speed v(w) of the hand at each frequency is what it takes.

For each filter and share there are two points: the least damping that is quiet, which is explicit because Z is linear
in it, and the least above it that is stable too; passive points have the largest share that the damping of the device
allows. The filters' cutoff
frequencies are searched for the reason given by Chawda, Celik and O'Malley (2015), ASME J. Mechanisms Robotics 7(2),
024501: a lower one adds lag, a higher one activity and noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid._internal.late import dataclass
from haptid._internal.pareto import pareto_front
from haptid.end_effector.characterisation.characterise import characterise
from haptid.end_effector.compensation.hands import HandModel, HandMotion, published_hands
from haptid.end_effector.compensation.inverse_dynamics import InverseDynamics
from haptid.end_effector.compensation.law import Compensation
from haptid.end_effector.compensation.sampled import SampledLoop
from haptid.errors import SettingError, setting_error

VELOCITY_CUTOFFS_HZ = (50.0, 200.0)
MOMENTUM_CUTOFFS_HZ = (8.0, 25.0, 60.0)
SHARES = (0.2, 0.35, 0.5, 0.65, 0.8)
# Search of the least stable damping: factor of its steps, their number, halvings of the last one (in the logarithm),
# and where it starts at the earliest, as a share of the impedance of the bare mass at the frequency of the verdict.
_FACTOR, _TRIED, _HALVINGS, _START = 1.6, 9, 3, 0.02
# Damping in addition to none at which the largest passive share is sought, as shares of that of the device.
_PASSIVE_DAMPINGS = (0.0, 0.25, 0.5, 0.75)
# Frequencies of a hand's motion that are examined, and steps of the search for a passive share.
_FREQUENCIES, _STEPS = 40, 12
_LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class JudgedLaw:
    """What a hand feels of a law, and its verdicts, worst over the poses.

    Attributes:
        reduction: of the felt mass, share of the bare one, along the direction of the largest mass.
        stiffness: felt, largest of all directions, N/m.
        added_damping: felt in addition to the bare device's, largest of all directions, N s/m.
        passive, stable, quiet: the verdicts; see the module.
        spectral_radius: of the worst hand and pose, or of the first that is not stable.
        missing_damping: damping at the handle that lacks for passivity, N s/m.
        power: largest mean power that a hand would get from a motion on purpose, W; negative: it loses that much.
    """

    reduction: float
    stiffness: float
    added_damping: float
    passive: bool
    stable: bool
    quiet: bool
    spectral_radius: float
    missing_damping: float
    power: float


@dataclass(frozen=True)
class DesignPoint(JudgedLaw):
    """Settings of a search and what they give.

    Attributes:
        law: the settings.
    """

    law: Compensation


@dataclass(frozen=True, eq=False)
class CompensationDesign:
    """All points of a search.

    Attributes:
        points: of the search.
        felt_hz: frequency at which mass and damping are felt.
        hands: of the verdict on stability.
        motion: of the verdict on energy.
    """

    points: tuple[DesignPoint, ...]
    felt_hz: float
    hands: tuple[HandModel | None, ...]
    motion: HandMotion

    def front(self, *verdicts: str) -> tuple[DesignPoint, ...]:
        """Points with these verdicts that no other such point beats in both reduction and damping, by reduction.

        Points with no felt mass left, or less than none, are left out: late damping acts like negative mass.

        Args:
            verdicts: any of "passive", "stable", "quiet".
        """
        kept = [p for p in self.points if p.reduction < 1 and all(getattr(p, verdict) for verdict in verdicts)]
        return pareto_front(kept, lambda point: (-point.reduction, point.added_damping))[::-1]

    def best(self, reduction: float) -> DesignPoint | None:
        """The stable and quiet point with at least this reduction and the least added damping; None where none is."""
        return next((p for p in self.front("stable", "quiet") if p.reduction >= reduction), None)

    def required(self, reduction: float, *verdicts: str) -> DesignPoint:
        """The point with these verdicts, at least this reduction and the least added damping.

        Raises:
            SettingError: there is none; it says how far the best one is away.
        """
        front = self.front(*verdicts)
        if found := next((p for p in front if p.reduction >= reduction), None):
            return found
        most = max((p.reduction for p in front), default=0.0)
        near = [p.missing_damping for p in self.points if p.reduction >= reduction]
        short = f"; {min(near):.3g} N s/m of damping at the handle are missing" if near else ""
        lacks = short if "passive" in verdicts else ""
        wanted = " and ".join(verdicts)
        raise SettingError(
            f"no point that is {wanted} takes away {100 * reduction:.3g} % of the felt mass, at most "
            f"{100 * most:.3g} %{lacks}.",
            where="reduction",
            found=reduction,
            limit=most,
            advice="Ask for less, add friction to the device, search other filters, or ask for `stable` and `quiet`, "
            "which hold in every hand of a set in place of any hand.",
        )


def design_compensation(
    law: Compensation,
    poses: ArrayLike,
    dt: float,
    delay: float = 0.0,
    *,
    felt_hz: float = 2.0,
    hands: Sequence[HandModel | None] | None = None,
    motion: HandMotion | None = None,
    friction_kept: float = 0.7,
    velocity_cutoffs_hz: Sequence[float] = VELOCITY_CUTOFFS_HZ,
    momentum_cutoffs_hz: Sequence[float] = MOMENTUM_CUTOFFS_HZ,
    shares: Sequence[float] = SHARES,
) -> CompensationDesign:
    """Search filters, shares and damping for compensation of mass that a hand can hold.

    Args:
        law: the model, and the settings that are not searched: weight, friction, `towards`.
        poses: positions of the active joints at which the verdicts have to hold, (active, poses), rad or m.
        dt: control period, s.
        delay: from reading positions to the torque, s.
        felt_hz: frequency at which felt mass and damping are judged.
        hands: of the verdict on stability; `published_hands()` and a free handle where None.
        motion: of the verdict on energy; the default one where None.
        friction_kept: share of the identified dry friction that is counted on.
        velocity_cutoffs_hz, momentum_cutoffs_hz: of the filters.
        shares: of the mass.

    Raises:
        SettingError: a setting out of range, or a pose at which the handle is singular.
        IncompleteDeviceError: the device has no handle.
    """
    qa, given = _checked(law, poses, dt, felt_hz, friction_kept, hands)
    bare = replace(law, share=0.0, damping=0.0, towards=None)
    bench = _Poses(law, bare, qa, dt, delay, motion or HandMotion(), friction_kept, felt_hz)
    points = []
    for velocity, momentum in product(velocity_cutoffs_hz, momentum_cutoffs_hz):
        filtered = replace(law, velocity_cutoff_hz=velocity, momentum_cutoff_hz=momentum, damping=0.0, share=0.0)
        for share in shares:
            quiet = bench.quiet_damping(replace(filtered, share=share))
            points.append(bench.point(quiet, given))
            if not points[-1].stable and (stable := bench.stable_damping(quiet, given)) is not None:
                points.append(bench.point(stable, given))
        for part in _PASSIVE_DAMPINGS:
            passive = bench.passive(replace(filtered, damping=part * bench.own_damping))
            if passive is not None:
                points.append(bench.point(passive, given))
    return CompensationDesign(tuple(points), felt_hz, given, bench.motion)


def judge_law(
    law: Compensation | InverseDynamics,
    poses: ArrayLike,
    dt: float,
    delay: float = 0.0,
    *,
    felt_hz: float = 2.0,
    hands: Sequence[HandModel | None] | None = None,
    motion: HandMotion | None = None,
    friction_kept: float = 0.7,
) -> JudgedLaw:
    """What a hand feels of one law, and its verdicts: as of a point of `design_compensation`, without a search.

    Compared with the device whose weight is carried, and no more. Friction compensation enters the verdict on stability
    by its slope at rest, without the dry friction that holds there: a law that is not stable may stay still.

    Args and errors: as of `design_compensation`.
    """
    qa, given = _checked(law, poses, dt, felt_hz, friction_kept, hands)
    bare = Compensation(law.identified, 0.0)
    return _Poses(law, bare, qa, dt, delay, motion or HandMotion(), friction_kept, felt_hz).judged(law, given)


def _checked(
    law: Compensation | InverseDynamics,
    poses: ArrayLike,
    dt: float,
    felt_hz: float,
    friction_kept: float,
    hands: Sequence[HandModel | None] | None,
) -> tuple[Array, tuple[HandModel | None, ...]]:
    """Poses as an array, and the hands; the errors of `design_compensation`."""
    qa = np.asarray(poses, dtype=float)
    expect("poses", qa.shape, (len(law.identified.model.device.active), None))
    if not 0 < felt_hz < 0.5 / dt:
        raise setting_error("felt_hz", felt_hz, f"above 0 and below {0.5 / dt:g}, half the control rate")
    if not 0 <= friction_kept <= 1:
        raise setting_error("friction_kept", friction_kept, "0 to 1")
    return qa, (*published_hands(), None) if hands is None else tuple(hands)


class _Poses:
    """The poses of a search: directions, dry friction and the bare device at each."""

    def __init__(
        self,
        law: Compensation | InverseDynamics,
        bare: Compensation,
        qa: Array,
        dt: float,
        delay: float,
        motion: HandMotion,
        kept: float,
        felt_hz: float,
    ) -> None:
        self.qa, self.dt, self.delay, self.motion, self.felt_hz = read_only(qa), dt, delay, motion, felt_hz
        self.frequencies = freeze(np.geomspace(0.02 * motion.bandwidth_hz, motion.bandwidth_hz, _FREQUENCIES))
        self.speeds = np.minimum(motion.speed, motion.acceleration / (2 * np.pi * self.frequencies))
        identified = law.identified
        found = characterise(identified, qa)
        if not found.handle.usable.all():
            bad = int(np.flatnonzero(~found.handle.usable)[0])
            raise setting_error("poses", qa[:, bad].tolist(), "poses at which the handle is not singular")
        self.directions = found.masses.directions  # (poses, r, m)
        self.friction = np.empty(self.directions.shape[:2])
        for p in range(len(self.directions)):
            here = characterise(identified, qa[:, [p]])
            for r, d in enumerate(self.directions[p]):
                self.friction[p, r] = kept * (1 - law.friction_taken) * float(here.coulomb_friction(d).values[0] @ d)
        self.bare = [self._felt(loop) for loop in self._loops(bare)]
        inverse = [np.linalg.pinv(loop.jacobian) for loop in self._loops(bare)]
        viscous = (loop.viscous for loop in self._loops(bare))
        self.own_damping = float(min(np.linalg.eigvalsh(x.T @ B @ x)[0] for x, B in zip(inverse, viscous, strict=True)))

    def _loops(self, law: Compensation | InverseDynamics) -> list[SampledLoop]:
        return [law.loop(q, self.dt, self.delay) for q in self.qa.T]

    def _felt(self, loop: SampledLoop) -> tuple[Array, Array, Array]:
        """Felt mass, damping and stiffness, (m, m) each, of w Im Z = mass w^2 - stiffness at two frequencies."""
        f = self.felt_hz * np.array([0.01, 1.0])
        Z = loop.impedance(f)
        slow, fast = (Z + Z.mT) / 2
        (a, b), w = (2 * np.pi * f) ** 2, 2 * np.pi * f
        mass = (w[1] * fast.imag - w[0] * slow.imag) / (b - a)
        return mass, fast.real, a * mass - w[0] * slow.imag

    def _losses(self, law: Compensation | InverseDynamics) -> Array:
        """Re Z + 4 Fc / (pi v) along every direction, (poses, directions, frequencies), N s/m."""
        Z = np.array([loop.impedance(self.frequencies).real for loop in self._loops(law)])
        along = np.einsum("prm,pfmk,prk->prf", self.directions, Z, self.directions)
        return np.asarray(along + 4 / np.pi * self.friction[:, :, None] / self.speeds)

    def quiet_damping(self, law: Compensation) -> Compensation:
        """The law with the least damping that is quiet."""
        without, one = self._losses(law), self._losses(replace(law, damping=1.0))
        gain = one - without
        if (gain <= 0).any():
            raise setting_error("velocity_cutoffs_hz", law.velocity_cutoff_hz, "a cutoff above a hand's motion")
        # A little more, so that rounding does not decide.
        return replace(law, damping=float(1.001 * np.maximum(-without / gain, 0.0).max()))

    def stable_damping(self, law: Compensation, hands: tuple[HandModel | None, ...]) -> Compensation | None:
        """The law with the least damping above its own that is stable; None where none is found."""
        start = _START * 2 * np.pi * self.felt_hz * max(float(np.trace(mass)) for mass, _, _ in self.bare)
        low, high = 0.0, max(law.damping, start)
        for _ in range(_TRIED):
            if self._radius(replace(law, damping=high), hands) < 1:
                break
            low, high = high, _FACTOR * high
        else:
            return None
        for _ in range(_HALVINGS if low > 0 else 0):
            middle = float(np.sqrt(low * high))
            if self._radius(replace(law, damping=middle), hands) < 1:
                high = middle
            else:
                low = middle
        return replace(law, damping=high)

    def _radius(self, law: Compensation | InverseDynamics, hands: tuple[HandModel | None, ...]) -> float:
        """Spectral radius of the worst hand and pose, or of the first that is not stable."""
        worst = 0.0
        for loop in self._loops(law):
            for hand in hands:
                worst = max(worst, loop.spectral_radius(hand))
                if worst >= 1:
                    return worst
        return worst

    def passive(self, law: Compensation) -> Compensation | None:
        """The law with the largest share that is passive, by bisection; None where there is none."""
        low, high = 0.0, 0.999
        for _ in range(_STEPS):
            middle = (low + high) / 2
            if all(loop.passive for loop in self._loops(replace(law, share=middle))):
                low = middle
            else:
                high = middle
        return replace(law, share=low) if low > _LEAST_SHARE else None

    def point(self, law: Compensation, hands: tuple[HandModel | None, ...]) -> DesignPoint:
        """One setting of the search."""
        return DesignPoint(**vars(self.judged(law, hands)), law=law)

    def judged(self, law: Compensation | InverseDynamics, hands: tuple[HandModel | None, ...]) -> JudgedLaw:
        """The figures of one setting."""
        loops = self._loops(law)
        reductions, added, stiffest = [], [], 0.0
        for loop, (mass, damping, _), directions in zip(loops, self.bare, self.directions, strict=True):
            now, damped, stiffness = self._felt(loop)
            stiffest = max(stiffest, float(np.linalg.eigvalsh(stiffness)[-1]))
            d = directions[0]
            reductions.append(1 - float(d @ now @ d) / float(d @ mass @ d))
            added.append(float(np.linalg.eigvalsh(damped - damping)[-1]))
        losses = self._losses(law)
        radius = self._radius(law, hands)
        missing = max(float(loop.missing_damping().max()) for loop in loops)
        return JudgedLaw(
            reduction=min(reductions),
            stiffness=stiffest,
            added_damping=max(added),
            passive=missing < 0,
            stable=radius < 1,
            quiet=bool(losses.min() > 0),
            spectral_radius=radius,
            missing_damping=missing,
            power=float((-losses * self.speeds**2 / 2).max()),
        )
