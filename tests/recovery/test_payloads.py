"""Payloads and drive gains are recovered from logs without and with them, inside their own intervals."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import haptid
from haptid import errors
from haptid.device.priors import PriorBody
from haptid.inference.payloads import links
from haptid.inference.payloads.body import FIGURES, body_figures
from haptid.inference.payloads.fit import rank_revealing
from haptid.observation.observation import MotorRows
from motions import motion

DEVICE = """
schema = 1
name = "three links"
gravity = [3.0, -9.0, 2.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
alpha = "pi/2"
d = 0.1
[[joints]]
name = "3"
d = 0.3
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
"""
# A second link that cannot lift: gravity along the axis of the first joint.
YAW = DEVICE.replace("[3.0, -9.0, 2.0]", "[0.0, 0.0, -9.81]")
LOAD = PriorBody(0.8, np.array([0.25, 0.05, 0.02]), np.diag([0.002, 0.004, 0.003]))
OTHER = PriorBody(0.3, np.array([0.1, -0.08, 0.04]), np.diag([0.001, 0.001, 0.0015]))
GAINS = np.array([0.8, 1.1, 1.25])


def device_of(folder, text=DEVICE):
    (folder / "device.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(folder / "device.toml"))


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return device_of(tmp_path_factory.mktemp("device"))


def true_beta(model):
    size = {"M": 0.6, "X": 0.12, "Y": 0.1, "Z": 0.15, "F": 0.4}
    return np.array([size[name[0]] * (1 + 0.1 * k) for k, name in enumerate(model.base.names)])


def recorded(model, load=None, seed=1, noise=0.02, gains=1.0, seconds=10.0, friction=1.0, link="3"):
    """A motion; `gains` is what the motors give over what the file says, (3,)."""
    beta = true_beta(model) + (haptid.observation.payload_torque(model, link, load) if load else 0.0)
    beta = beta * [friction if name[0] == "F" else 1.0 for name in model.base.names]
    moved = motion(model, beta, seconds=seconds, dt=5e-3, seed=seed, noise=noise)
    return haptid.Motion(moved.dt, moved.q, moved.tau / gains, moved.treatment, rates=moved.rates)


def figures_of(body):
    """In the order of FIGURES."""
    J = body.inertia
    return np.array([body.mass, *body.com, *np.diag(J), J[0, 1], J[0, 2], J[1, 2]])


def unknown(name="tool", link="3", **known):
    return haptid.inference.AttachedBody(name, link, **known)


def test_a_payload_is_the_base_parameters_of_its_body(model):
    shift = haptid.observation.payload_torque(model, "3", LOAD)
    chi = np.zeros(len(model.device.parameters.names))
    index, com = model.device.parameters.index, LOAD.com
    J = LOAD.inertia + LOAD.mass * (com @ com * np.eye(3) - np.outer(com, com))
    for kind, value in zip(("XX", "YY", "ZZ", "XY", "XZ", "YZ"), (*np.diag(J), J[0, 1], J[0, 2], J[1, 2]), strict=True):
        chi[index[f"{kind}3"]] = value
    for kind, value in zip(("MX", "MY", "MZ"), LOAD.mass * com, strict=True):
        chi[index[f"{kind}3"]] = value
    chi[index["M3"]] = LOAD.mass
    np.testing.assert_allclose(shift, model.base.of(chi), rtol=1e-12, atol=1e-15)
    joint = model.device.joints[2]
    ten = chi[[index[f"{kind}3"] for kind in ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")]]
    np.testing.assert_allclose(body_figures(joint, ten), figures_of(LOAD), atol=1e-15)


def test_logs_with_and_without_a_known_payload_give_one_model(model):
    inside = []
    for seed in range(1, 9, 2):
        bare, loaded = recorded(model, seed=seed), recorded(model, LOAD, seed=seed + 1)
        both = haptid.observe(model, bare) + haptid.observe(
            model, haptid.observation.without_payload(model, loaded, "3", LOAD)
        )
        low, high = haptid.estimate(both, haptid.WLS()).conf_int().T
        inside.append(((low < true_beta(model)) & (true_beta(model) < high)).mean())
    assert np.mean(inside) >= 0.85
    exact = haptid.observe(
        model, haptid.observation.without_payload(model, recorded(model, LOAD, noise=0.0), "3", LOAD)
    )
    np.testing.assert_allclose(haptid.estimate(exact, haptid.OLS()).beta, true_beta(model), rtol=1e-9)


@pytest.mark.parametrize("known", [{}, {"mass": 0.8}, {"com": LOAD.com}, {"mass": 0.8, "com": LOAD.com}])
def test_without_noise_a_payload_is_exact_whatever_is_known_of_it(model, known):
    """Two payloads at once, on two links, friction 40 % higher under load."""
    bare = recorded(model, noise=0.0)
    loaded = [
        (unknown("tool", **known), recorded(model, LOAD, 2, noise=0.0, friction=1.4)),
        (unknown("sensor", "2"), recorded(model, OTHER, 3, noise=0.0, link="2")),
    ]
    found = haptid.identify_payloads(model, bare, loaded)
    body, truth = found["tool"].body, dict(zip(FIGURES, figures_of(LOAD), strict=True))
    assert len(body) == 10 - ("mass" in known) - 3 * ("com" in known)
    np.testing.assert_allclose(body.values, [truth[name] for name in body.names], atol=1e-8)
    assert not found["tool"].consistent.changed
    assert found["sensor"]["mass"] == pytest.approx(0.3, rel=1e-8)
    truth = dict(zip(model.base.names, true_beta(model), strict=True))
    np.testing.assert_allclose(
        found.base.values,
        [truth[n] for n in found.base.names],
        rtol=1e-7,
    )


@pytest.mark.parametrize("known", [{}, {"mass": 0.8}])
def test_a_payload_on_another_link_than_said_is_told(model, known):
    """A body of 0.8 kg on the last link was given as one of 0.3 to 1 kg on the second, with narrow intervals."""
    bare, loaded = recorded(model, None, 2, seconds=16.0), recorded(model, LOAD, 3, seconds=16.0)
    (note,) = haptid.identify_payloads(model, bare, [(unknown(link="2", **known), loaded)]).notes
    assert note.startswith("Payload tool is better explained on link 3")
    assert ("mass 0.8" in note) is not bool(known)
    assert haptid.identify_payloads(model, bare, [(unknown(link="3", **known), loaded)]).notes == ()


def test_three_payloads_on_one_wrong_link_are_all_told_of_the_right_one(model):
    """Each was judged beside the others, whose wrong link changes the parameters that all share."""
    sizes = ((0.4, 0.05), (0.8, -0.05), (1.2, 0.0))
    bodies = [PriorBody(mass, np.array([0.2, y, 0.02]), np.eye(3) * 0.003) for mass, y in sizes]
    loads = [(unknown(f"load {k}", "2"), recorded(model, body, 3 + k, seconds=16.0)) for k, body in enumerate(bodies)]
    notes = haptid.identify_payloads(model, recorded(model, None, 2, seconds=16.0), loads).notes
    assert [note[:44] for note in notes] == [f"Payload load {k} is better explained on link 3" for k in range(3)]


@pytest.mark.parametrize("motor", range(3))
def test_a_drive_that_gives_less_torque_with_the_payload_is_told(model, motor):
    """Of 15 %, in the first motor: 1.4 kg in place of 0.8 kg, with an interval of 0.1 kg, and no word."""
    given = np.where(np.arange(3) == motor, 0.85, 1.0)
    bare, loaded = recorded(model, None, 2), recorded(model, LOAD, 3, gains=given)
    (note,) = haptid.identify_payloads(model, bare, [(unknown(), loaded)]).notes
    told = re.fullmatch(r"With payload tool the drive of motor (\d) gives (\S+) times .*", note)
    assert told is not None
    assert int(told[1]) == motor + 1
    assert float(told[2]) == pytest.approx(0.85, abs=0.02)


def test_a_body_that_another_link_would_explain_as_well_is_said_to_be_untold(model):
    bare, loaded = recorded(model, None, 2, seconds=16.0), recorded(model, LOAD, 3, link="2", seconds=16.0)
    (note,) = haptid.identify_payloads(model, bare, [(unknown(link="3"), loaded)]).notes
    assert note.startswith("These logs do not tell whether payload tool is on link 3, or on 2 with ")


def test_a_change_that_is_no_body_is_said(model):
    """Friction that is taken as that of the bare device, and is not."""
    bare = recorded(model, None, 2, seconds=16.0)
    for friction, notes in ((1.0, 0), (1.8, 1)):
        loaded = recorded(model, LOAD, 3, seconds=16.0, friction=friction)
        found = haptid.identify_payloads(model, bare, [(unknown(link="3"), loaded)], shared_friction=True).notes
        assert len(found) == notes
        assert all("something else changed too" in note for note in found)


def test_a_mass_below_zero_is_no_body_and_no_other_link_is_named_for_one(model):
    """Logs with and without the load taken for each other."""
    bare, loaded = recorded(model, None, 2, seconds=16.0), recorded(model, LOAD, 3, seconds=16.0)
    for said in ("3", "2"):
        (note,) = haptid.identify_payloads(model, loaded, [(unknown(link=said), bare)]).notes
        assert ("would be -0.8" in note and "below zero" in note) or "something else changed too" in note
        assert "better explained" not in note


def test_halves_are_summed_once_and_no_mass_is_fitted_that_no_sentence_has(model, monkeypatch):
    """Of each log two halves and the whole; a fit of all blocks for each link took nine times as long."""
    summed, fits = [], []
    monkeypatch.setattr(links, "summed", lambda rows, own=links.summed: summed.append(rows) or own(rows))
    fit = lambda rows, *rest, own=links.joint_fit: fits.append(rows[0].observation) or own(rows, *rest)  # noqa: E731
    monkeypatch.setattr(links, "joint_fit", fit)
    bare, loaded = recorded(model, None, 2, seconds=16.0), recorded(model, LOAD, 3, seconds=16.0)
    for said, most in (("3", 2), ("2", 1)):  # drives and mass of the right link, the mass on the better one
        summed.clear(), fits.clear()
        assert bool(haptid.identify_payloads(model, bare, [(unknown(link=said), loaded)]).notes) is (said == "2")
        assert len(summed) == 6
        assert sum(len(one.blocks) > 1 for one in fits) == most


def test_a_link_whose_fit_does_not_converge_ends_no_identification(model, monkeypatch):
    def fit(rows, *rest, own=links.joint_fit):
        if len(rows[0].observation.blocks) > 1:
            raise errors.ConvergenceError("the drive gains still change.")
        return own(rows, *rest)

    monkeypatch.setattr(links, "joint_fit", fit)
    bare, loaded = recorded(model, None, 2, seconds=16.0), recorded(model, LOAD, 3, seconds=16.0)
    (note,) = haptid.identify_payloads(model, bare, [(unknown(link="2"), loaded)]).notes
    assert note.startswith("Payload tool is better explained on link 3 than on 2")


@pytest.mark.parametrize(
    ("bare", "own", "other", "mass", "named"),
    [(10, 5, 1, 0.02, True), (10, 5, 1, -0.02, False), (10, 20, 12, 0.02, False), (10, 20, 5, 0.02, True)],
)
def test_a_link_is_named_for_a_mass_above_zero_that_leaves_less_than_no_body(
    model, monkeypatch, bare, own, other, mass, named
):
    """What one block leaves over with no body, on the link that is said, and on the others; mass +-0.05 kg there."""

    def left_over(test, layout, at_gains=False):
        size = own if layout is test.layout else other
        if at_gains:
            size = own if layout.bases[0].shape[1] else bare
        return size * np.linspace(0.95, 1.05, len(test.rows[1].observation.blocks))

    monkeypatch.setattr(links.LinkTest, "_errors", left_over)
    monkeypatch.setattr(links.LinkTest, "_mass", lambda *_: (mass, mass - 0.05, mass + 0.05))
    logs = recorded(model, None, 2, seconds=16.0), recorded(model, LOAD, 3, seconds=16.0)
    notes = haptid.identify_payloads(model, logs[0], [(unknown(), logs[1])]).notes
    assert any("better explained" in note for note in notes) is named
    for share in re.findall(r"explains (\S+) %", " ".join(notes)):
        assert 0 <= float(share) < 100


def test_without_noise_what_is_left_is_said_to_be_nothing(model):
    bare, loaded = recorded(model, None, 2, 0.0, seconds=16.0), recorded(model, LOAD, 3, 0.0, seconds=16.0)
    (note,) = haptid.identify_payloads(model, bare, [(unknown(link="2"), loaded)]).notes
    assert "leaves over much, one on 3 nearly nothing. Check" in note
    assert haptid.identify_payloads(model, bare, [(unknown(link="3"), loaded)]).notes == ()


def test_a_right_link_is_seldom_doubted_under_friction_that_the_model_lacks(model):
    """Beside friction in proportion to the torque, and ripple, of which the rows of both logs have other parts."""
    doubted = 0
    for seed in range(12):
        motions = [recorded(model, load, 2 * seed + k) for k, load in enumerate((None, LOAD))]
        for k, one in enumerate(motions):
            more = 0.06 * np.abs(one.tau) * np.tanh(10 * np.gradient(one.q, one.dt, axis=0)) + 0.03 * np.sin(7 * one.q)
            motions[k] = haptid.Motion(one.dt, one.q, one.tau + more, one.treatment, rates=one.rates)
        doubted += bool(haptid.identify_payloads(model, motions[0], [(unknown(), motions[1])]).notes)
    assert doubted <= stats.binom.ppf(0.999, 12, 0.05)


def test_intervals_of_a_payload_cover_it(model):
    """Forty pairs of logs: the hits of mass and centre of mass are binomial at 95 %."""
    bare_uncertain, hits = [], []
    for seed in range(40):
        bare, loaded = recorded(model, None, 2 * seed, seconds=6.0), recorded(model, LOAD, 2 * seed + 1, seconds=6.0)
        body = haptid.identify_payloads(model, bare, [(unknown(), loaded)])["tool"].body
        low, high = body.conf_int().T
        hits.append((low <= figures_of(LOAD)) & (figures_of(LOAD) <= high))
        bare_uncertain.append(body.se[0])
    least = stats.binom.ppf(1e-6, len(hits), 0.95)
    assert (np.sum(hits, axis=0) >= least).all()
    assert np.median(bare_uncertain) < 0.05 * LOAD.mass


def test_the_interval_has_the_uncertainty_of_both_logs(model):
    """A bare log four times as long narrows it towards that of the loaded log alone; no further."""
    loaded = recorded(model, LOAD, 5)
    short, long = (
        haptid.identify_payloads(model, recorded(model, None, 4, seconds=s), [(unknown(), loaded)])["tool"].body.se[0]
        for s in (6.0, 24.0)
    )
    fixed = haptid.identify_payloads(model, recorded(model, None, 4, noise=0.0, seconds=24.0), [(unknown(), loaded)])
    assert long < short
    assert fixed["tool"].body.se[0] < long


def test_a_payload_is_physically_consistent_where_the_free_one_is_not(model):
    """A light body far out, whose inertia about its centre is lost in the noise."""
    light = PriorBody(0.2, np.array([0.3, 0.0, 0.0]), 1e-5 * np.eye(3))
    found = haptid.identify_payloads(
        model, recorded(model, noise=0.05), [(unknown(), recorded(model, light, 2, noise=0.05))]
    )["tool"]
    consistent = found.consistent
    assert consistent.changed
    assert np.linalg.eigvalsh(consistent.pseudo_inertia)[0] > -1e-8
    assert consistent.body[0] > 0
    assert 0 < consistent.worse < 1.0
    low, high = found.body.conf_int()[0]
    assert low <= consistent.body[0] <= high
    assert "No rigid body" in found.summary()


@pytest.mark.parametrize("known", [{"mass": 0.8}, {"mass": 0.8, "com": LOAD.com, "inertia": LOAD.inertia}])
def test_gains_are_exact_without_noise_with_the_centre_of_mass_unknown(model, known):
    bare, loaded = (recorded(model, load, seed, noise=0.0, gains=GAINS) for load, seed in ((None, 1), (LOAD, 2)))
    found = haptid.identify_payloads(model, bare, [(unknown(**known), loaded)], gains=True)
    np.testing.assert_allclose(found.gains.values, GAINS, rtol=1e-7)
    if len(known) == 1:
        np.testing.assert_allclose(found["tool"].body.values, figures_of(LOAD)[1:], atol=1e-7)


def test_gains_are_inside_their_intervals(model):
    """Thirty draws; of one draw the hits of two motors correlate by 0.6 to 0.75."""
    inside, off = [], []
    for seed in range(30):
        bare = recorded(model, None, seed, gains=GAINS, seconds=6.0)
        loaded = recorded(model, LOAD, 100 + seed, gains=GAINS, seconds=6.0)
        found = haptid.identify_payloads(model, bare, [(unknown(mass=0.8), loaded)], gains=True).gains
        low, high = found.quantities.conf_int().T
        inside.append(((low < GAINS) & (high > GAINS)).mean())
        off.append(np.abs(found.values / GAINS - 1).max())
    assert np.sum(inside) >= stats.binom.ppf(1e-6, 30, 0.95)
    assert np.median(off) < 0.05
    assert "of the file's gain" in found.summary()


def test_a_motor_that_the_payload_does_not_load_is_named_and_left_out(tmp_path):
    """A known mass of unknown place turns with the vertical joint: only unknown inertia loads that motor."""
    yaw = device_of(tmp_path, YAW)
    bare, loaded = (recorded(yaw, load, seed, gains=GAINS, noise=0.005) for load, seed in ((None, 1), (LOAD, 2)))
    on_the_first = haptid.identify_payloads(
        yaw,
        bare,
        [(unknown(mass=0.8), loaded), (unknown("low", "1", mass=0.3), recorded(yaw, OTHER, 3, 0.005, GAINS, link="1"))],
        gains=True,
    )
    assert on_the_first["low"].left_out
    still = replace(loaded, q=bare.q, tau=bare.tau, rates=bare.rates)
    with pytest.raises(errors.IdentifiabilityError, match="no motor"):
        haptid.identify_payloads(yaw, recorded(yaw, None, 7), [(unknown("low", "1", mass=0.3), still)], gains=True)


def test_symmetries_of_the_bare_link_are_not_those_of_the_payload(model, tmp_path):
    """The device has MZ3 = YZ3 = 0; the payload on link 3 has both."""
    flat = device_of(tmp_path, DEVICE + '[[symmetry]]\nreason = "flat"\nzero = ["MZ3", "YZ3", "XZ3"]\n')
    beta = true_beta(flat)
    chi = np.zeros(len(flat.device.parameters))
    chi[list(flat.base.independent_columns)] = beta
    whole = np.zeros(len(model.device.parameters))
    for name, value in zip(flat.device.parameters.names, chi, strict=True):
        whole[model.device.parameters.index[name]] = value
    clean = model.base.of(whole)
    made = []
    for seed, load in ((1, None), (2, LOAD)):
        own = clean + (haptid.observation.payload_torque(model, "3", load) if load else 0.0)
        made.append(motion(model, own, seconds=8.0, dt=5e-3, seed=seed))
    found = haptid.identify_payloads(flat, made[0], [(unknown(), made[1])])
    np.testing.assert_allclose(found["tool"].body.values, figures_of(LOAD), atol=1e-7)
    assert "MZ3" in found.notes[0]


def test_what_cannot_be_is_refused(model):
    with pytest.raises(errors.UnknownNameError):
        haptid.observation.payload_torque(model, "9", LOAD)
    bare, loaded = recorded(model, seconds=4.0), recorded(model, LOAD, 2, seconds=4.0)
    for faulty, error in (
        ([(unknown(link="9"), loaded)], errors.UnknownNameError),
        ([], errors.SettingError),
        ([(unknown(), loaded), (unknown(), loaded)], errors.SettingError),
        ([(unknown(), bare)], errors.SharedRowsError),
    ):
        with pytest.raises(error):
            haptid.identify_payloads(model, bare, faulty)
    with pytest.raises(errors.SettingError, match="mass of every payload"):
        haptid.identify_payloads(model, bare, [(unknown(), loaded)], gains=True)
    for known in ({"mass": 0.0}, {"inertia": np.eye(3)}, {"mass": 1.0, "inertia": np.eye(3)}):
        with pytest.raises(errors.SettingError):
            unknown(**known)


def test_the_least_norm_solution_is_that_of_the_pseudo_inverse():
    rng = np.random.default_rng(1)
    W = rng.normal(size=(30, 5)) @ rng.normal(size=(5, 8))
    W[:, 6] = 0.0
    y = rng.normal(size=30)
    T = np.linalg.qr(np.column_stack([W, y]), mode="r")
    rows = MotorRows("1", "motor 1", "N m", np.arange(8), T[None], np.array([30]))
    solution, null, scale = rank_revealing([rows], np.ones(1), 8)
    lengths = np.where(np.linalg.norm(W, axis=0) > 0, np.linalg.norm(W, axis=0), 1.0)
    np.testing.assert_allclose(scale, lengths)
    np.testing.assert_allclose(solution.beta, np.linalg.pinv(W / lengths) @ y / lengths, atol=1e-10)
    np.testing.assert_allclose(W / lengths @ null, 0.0, atol=1e-10)
    assert null.shape == (8, 3)
    assert solution.rest == pytest.approx(np.linalg.norm(y - W @ solution.beta))
