"""Play from the motor side: a loose link against its closed form, size and interval on made logs, silence on others."""

from __future__ import annotations

import numpy as np
import pytest

import haptid
from haptid.inference.diagnosis.play import transmission_play
from haptid.simulation.play import LooseLinks
from loose_axis import Axis, estimated, recorded


def test_a_loose_link_lands_with_the_momentum_that_it_lacked():
    """A motor that brakes evenly: its link goes on at the speed that it had, for the root of 2 b / a."""
    dt, M, brake, b, share = 1e-4, 0.2, 5.0, 0.004, 0.6
    t = dt * np.arange(2000)
    begin = 500
    a = np.where(t >= t[begin], -brake, 0.0)
    a[:300] = 20.0  # lands on the flank that drives
    v = 1.0 + np.cumsum(a) * dt - a * dt
    x = np.concatenate([[0.0], np.cumsum(v)[1:] * dt])
    links = LooseLinks.of(dt, (x[None], v[None], a[None]), M * a[None], 0 * a[None], np.full((1, len(t)), M))
    (change,) = links.change(np.array([[b]]), np.array([[share]]), np.array([[0.0]]))[0]
    crossing = round(np.sqrt(2 * b / brake) / dt)
    loose = change[begin + 2 : begin + crossing - 2]
    np.testing.assert_allclose(loose, share * M * brake, rtol=1e-6)
    landed = change[begin : begin + crossing + 5]
    assert landed.sum() * dt == pytest.approx(0.0, abs=1e-3 * share * M * brake * crossing * dt)
    assert landed.min() * dt == pytest.approx(-share * M * brake * crossing * dt, rel=0.02)
    assert np.abs(change[begin + crossing + 5 : -1]).max() < 1e-6 * share * M * brake


def stepped(links, motor, size, share, friction):
    """What flanks add in each step, step by step."""
    dt, half, place, added = links.dt, 0.5 * size, 0.0, []
    v, M = links.v[motor], links.inertia[motor]
    moved, last = dt * v[0], len(v) - 1
    for k, x in enumerate(links.x[motor]):
        following, own = min(k + 1, last), share * M[k]
        free = (1 - dt * friction * links.viscous[motor] / own) * moved - dt**2 * links.rest[motor, k] / own
        dry = dt**2 * friction * links.dry[motor] / own
        free -= min(max(free, -dry), dry)
        ahead = place + free - (links.x[motor, following] - x)
        place = min(max(ahead, -half), half)
        lands = (place - ahead) * (dt * v[following] - free) > 0
        moved = dt * v[following] if lands else free
        added.append(moved - free)
    return np.array(added)


def test_steps_are_those_of_unilateral_contact():
    """Also where a link crosses the play for long, and hangs between the flanks."""
    dt, rng = 1e-3, np.random.default_rng(0)
    t = dt * np.arange(1000)
    f = np.array([[0.7], [1.3]])
    x, v, a = np.sin(2 * np.pi * f * t), 2 * np.pi * f * np.cos(2 * np.pi * f * t), -((2 * np.pi * f) ** 2)
    a = a * x
    friction = 0.3 * np.sign(v) + 0.1 * v
    M = 0.2 + 0.05 * np.cos(x)
    links = LooseLinks.of(dt, (x, v, a), M * a + friction + 0.4 * np.sin(3 * x), friction, M)
    cases = rng.uniform((1e-3, 0.3, 0.0), (0.5, 1.0, 1.0), (2, 20, 3))
    cases[0, 0, 0] = 1.9
    made = links.change(*np.moveaxis(cases, 2, 0))
    for motor, case in np.ndindex(2, 20):
        size, share, on_link = cases[motor, case]
        without = M[motor] * a[motor] * share + links.rest[motor]
        without = without + on_link * (links.dry[motor] * np.sign(v[motor]) + links.viscous[motor] * v[motor])
        whole = share * M[motor] / dt**2 * stepped(links, motor, size, share, on_link) - without
        # Rounding of a step is that of its displacement, multiplied by inertia over dt^2.
        atol = 1e-12 * np.abs(v[motor]).max() * M[motor].max() / dt
        np.testing.assert_allclose(made[motor, case, :-1], whole[:-1], rtol=1e-9, atol=atol)


@pytest.mark.parametrize(
    "axis",
    [Axis(0.005), Axis(0.01, counts=4096.0, gravity=True)],
    ids=["fine encoder", "12 bits, against gravity"],
)
def test_play_is_named_with_its_size(axis):
    """Against two bodies with a spring outside a dead zone."""
    (log,) = recorded(axis, [0], seconds=10.0)
    finding = transmission_play(estimated(axis, log))
    assert finding.status == "bad"
    low, size, high = (finding.figures[f"motor 1, {name}"] for name in ("low", "play", "high"))
    assert size == pytest.approx(axis.play, rel=0.15)
    assert low < axis.play < high < 3 * low
    assert "motor 1" in finding.sentence


def test_the_interval_allows_for_friction_at_the_motor():
    """Five sixths of the friction, against gravity: the search takes it for the link's."""
    axis = Axis(0.002, (0.05, 0.25), gravity=True)
    (log,) = recorded(axis, [0], seconds=10.0)
    finding = transmission_play(estimated(axis, log))
    assert finding.figures["motor 1, low"] < axis.play < finding.figures["motor 1, high"]


@pytest.mark.parametrize(
    "axis",
    [Axis(counts=4096.0), Axis(presliding=0.05, stribeck=0.7), Axis(gravity=True), Axis(0.0, stiffness=300.0)],
    ids=["12 bits", "presliding", "gravity", "elastic"],
)
def test_nothing_is_said_without_play(axis):
    (log,) = recorded(axis, [0], seconds=10.0)
    finding = transmission_play(estimated(axis, log))
    assert finding.status == "ok"
    assert not finding.figures


def test_a_diagnosis_tells_of_play():
    axis = Axis(0.005)
    (log,) = recorded(axis, [1], seconds=10.0)
    assert haptid.diagnose(estimated(axis, log))["play"].status == "bad"
