"""Slopes of rows by the channels of a motion: of torques and of forms, against differences of the rows themselves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptid import _core
from mechanisms import Random, draw, mechanisms, states

# Every law, each with a slope everywhere but the first: that one jumps at rest, and is level elsewhere.
LAWS = (
    ("coulomb", 0.0, 0.0, 0.0),
    ("rotor", 0.0, 0.0, 0.0),
    ("viscous", 0.0, 0.0, 0.0),
    ("coulomb", 0.3, 0.0, 0.0),
    ("coulomb+", 0.3, 0.0, 0.0),
    ("coulomb-", 0.3, 0.0, 0.0),
    ("stribeck", 0.7, 1.5, 0.3),
    ("offset", 0.0, 0.0, 0.0),
    ("spring", 0.2, 0.0, 0.0),
    ("external", 0.0, 0.0, 0.0),
    ("external", 0.0, 0.0, 0.0),
)
# Of central differences: their error falls with the square of the step, and rounding grows with its inverse.
STEP, TOLERANCE = 1e-5, 1e-7


def tree(seed: int) -> Random:
    return draw(seed, 6, closed=False)


def terms(mechanism: Random, rng: np.random.Generator) -> tuple:
    return tuple((kind, rng.normal(size=mechanism.coordinates), 0.1, a, b, c) for kind, a, b, c in LAWS)


def looped(mechanism: Random, backend: str, rng: np.random.Generator) -> tuple[_core.Mechanism, int]:
    """The mechanism with some rates given, terms on joints among its terms, and its number of channels for loops."""
    given = rng.random(mechanism.rates.shape) < 0.4
    on = [int(rng.integers(len(mechanism.parent))) if rng.random() < 0.5 else None for _ in LAWS]
    r = mechanism
    made = _core.Mechanism(
        r.parent,
        r.rotation,
        r.translation,
        r.prismatic,
        list(r.gravity),
        r.rates,
        r.offset,
        list(terms(r, rng)),
        backend,
        given,
        on,
    )
    return made, int(sum(1 + 2 * row.sum() for row in given if row.any()))


def motion(mechanism: Random, loops: int, samples: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Positions, velocities, accelerations, two external columns, and loops."""
    na = mechanism.coordinates
    drawn = [rng.normal(size=(many, samples)) for many in (na, na, na, 2, loops)]
    # Friction has a kink at zero, which no difference may cross.
    return [np.where(np.abs(x) < 4 * STEP, 4 * STEP, x) for x in drawn]


def moved(channels: list[np.ndarray], channel: int, step: float) -> list[np.ndarray]:
    every = np.concatenate(channels)
    every[channel] += step
    ends = np.cumsum([len(x) for x in channels])[:-1]
    return [np.ascontiguousarray(x) for x in np.split(every, ends)]


def difference(value, channels: list[np.ndarray], channel: int) -> np.ndarray:
    """By central differences, of what is a function of the channels."""
    return (value(moved(channels, channel, STEP)) - value(moved(channels, channel, -STEP))) / (2 * STEP)


def formed(rows: np.ndarray, form: np.ndarray) -> np.ndarray:
    """A quadratic form, summed over all torques' rows."""
    return np.einsum("apk,pq,aqk->k", rows, form, rows)


@settings(max_examples=25, deadline=None)
@given(
    mechanism=mechanisms(7),
    samples=st.sampled_from([1, 7, 8, 37]),
    varying=st.booleans(),
    seed=st.integers(0, 2**31),
)
@pytest.mark.parametrize("backend", _core.backends())
def test_slopes_are_differences_of_the_rows(backend, mechanism, samples, varying, seed):
    rng = np.random.default_rng(seed)
    core, loops = looped(mechanism, backend, rng) if varying else (mechanism.core(backend, terms(mechanism, rng)), 0)
    channels = motion(mechanism, loops, samples, rng)
    chosen = [int(c) for c in rng.permutation(core.columns)[: rng.integers(1, core.columns + 1)]]
    chi = rng.normal(size=len(chosen))
    form, factors = rng.normal(size=(len(chosen),) * 2), rng.normal(size=(core.coordinates, len(chosen)))

    def rows(x: list[np.ndarray]) -> np.ndarray:
        return core.regressor(*x[:4], chosen, x[4])

    of_torque = core.torque_slopes(*channels[:4], chosen, chi.tolist(), channels[4])
    of_form = core.form_slopes(*channels[:4], chosen, form, factors, channels[4])
    size = 1.0 + np.abs(rows(channels)).max()
    for c in range(len(np.concatenate(channels))):
        torque = difference(lambda x: np.einsum("apk,p->ak", rows(x), chi), channels, c)
        np.testing.assert_allclose(of_torque[:, c], torque, atol=TOLERANCE * size**2)
        along = difference(lambda x: formed(factors[:, :, None] * rows(x), form), channels, c)
        np.testing.assert_allclose(of_form[c], along, rtol=1e-6, atol=TOLERANCE * size**3 * len(chosen))


@pytest.mark.parametrize("backend", _core.backends())
@pytest.mark.parametrize("samples", [0, 1, 37, 128, 2501, 4000])
def test_inner_products_are_those_of_the_regressor(backend, samples):
    mechanism = tree(3)
    rng = np.random.default_rng(samples)
    core = mechanism.core(backend, terms(mechanism, rng))
    channels = motion(mechanism, 0, samples, rng)
    for many in (1, 2, 31, core.columns):
        chosen = [int(c) for c in rng.permutation(core.columns)[:many]]
        Y = core.regressor(*channels[:4], chosen)
        factors = rng.normal(size=(core.coordinates, many))
        factors[1] = 0.0
        Y *= factors[:, :, None]
        wanted = (Y @ Y.transpose(0, 2, 1)).sum(axis=0)
        found = core.inner_products(*channels[:4], chosen, factors)
        np.testing.assert_allclose(found, wanted, atol=1e-13 * max(1.0, np.abs(wanted).max(initial=0.0)))


def test_a_long_motion_in_parts_is_a_short_one():
    mechanism = tree(5)
    core = mechanism.core()
    c, cd, cdd = states(mechanism, 5000)
    none, columns = np.zeros((0, 5000)), list(range(core.columns))
    chi = mechanism.chi.tolist()
    form = np.random.default_rng(0).normal(size=(core.columns, core.columns))
    factors = np.random.default_rng(1).normal(size=(core.coordinates, core.columns))
    torque = core.torque_slopes(c, cd, cdd, none, columns, chi)
    slopes = core.form_slopes(c, cd, cdd, none, columns, form, factors)
    some = slice(3001, 3012)
    part = [np.ascontiguousarray(x[:, some]) for x in (c, cd, cdd, none)]
    np.testing.assert_array_equal(core.torque_slopes(*part, columns, chi), torque[:, :, some])
    np.testing.assert_array_equal(core.form_slopes(*part, columns, form, factors), slopes[:, some])


def test_wrong_shapes_are_rejected():
    mechanism = tree(1)
    core = mechanism.core()
    c, cd, cdd = states(mechanism, 4)
    none = np.zeros((0, 4))
    factors = np.ones((core.coordinates, 2))
    with pytest.raises(ValueError, match="form has length 6, wanted 4"):
        core.form_slopes(c, cd, cdd, none, [0, 1], np.zeros((2, 3)), factors)
    with pytest.raises(ValueError, match="factors has length 3, wanted"):
        core.form_slopes(c, cd, cdd, none, [0, 1], np.zeros((2, 2)), np.ones((1, 3)))
    with pytest.raises(ValueError, match="chi has length 3, wanted 2"):
        core.torque_slopes(c, cd, cdd, none, [0, 1], [1.0] * 3)
    with pytest.raises(ValueError, match="column 1 is given twice"):
        core.inner_products(c, cd, cdd, none, [1, 1], factors)
