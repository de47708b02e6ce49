"""The player of motions in C: compiled strictly, run in the loop of the bench, stopped by every fault it watches."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from typer.testing import CliRunner

from compiled import STRICT
from haptid import errors
from haptid.cli import app
from haptid.experiment import bench
from haptid.experiment.excitation import MotionSamples, PlayerSettings, write_player
from small_study import FRICTION, KD, KP, two_links
from true_parameters import true_parameters

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
RATE, JOINTS = 250.0, 2
STATUS = ("idle", "approaching", "playing", "done", "stopped")
REASONS = ("", "tracking", "range", "fast", "late", "finite", "asked", "no such")
DOUBLES = ctypes.POINTER(ctypes.c_double)
VECTOR = ctypes.c_double * JOINTS


class Row(ctypes.Structure):
    _fields_ = (
        ("number", ctypes.c_uint),
        ("status", ctypes.c_int),
        ("motion", ctypes.c_int),
        ("t", ctypes.c_double),
        ("plan", ctypes.c_double),
        ("q", VECTOR),
        ("q_ref", VECTOR),
        ("tau", VECTOR),
    )


class Head(ctypes.Structure):
    _fields_ = (("status", ctypes.c_int), ("reason", ctypes.c_int), ("joint", ctypes.c_int))


def samples(seed, seconds=4.0):
    """A motion of the two links that begins and ends at rest."""
    kind = bench.Multisine(seconds, (0.0, 0.5), (0.6, 0.5), speed=(2.0, 2.0))
    made = bench.plan(kind, two_links(), 1 / RATE, np.random.default_rng(seed))
    return MotionSamples("two links", ("1", "2"), ("1", "2"), (False, False), RATE, made.q, made.qd, made.qdd)


MOTIONS = (samples(1), samples(2, 3.0))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("player")
    source = write_player(folder / "swing.c", MOTIONS, PlayerSettings(records=1024))
    flags = [*STRICT, "-DSWING_STDIO", "-O2", "-fPIC", "-shared", "-o", str(folder / "swing.so")]
    subprocess.run(["cc", *flags, str(source), "-lm"], check=True)
    return ctypes.CDLL(str(folder / "swing.so"))


class Player:
    """One player's state, with arrays in place of pointers."""

    def __init__(self, library):
        self.library = library
        self.state = (ctypes.c_char * 1_000_000)()  # larger than the struct
        self.head = Head.from_buffer(self.state)

    def start(self, motion, speed, q):
        self.library.swing_start(self.state, motion, ctypes.c_double(speed), VECTOR(*q))
        return self.status

    def step(self, dt, q, tau=(0.0, 0.0)):
        q_ref, qd_ref, share = VECTOR(), VECTOR(), ctypes.c_double()
        arguments = (self.state, ctypes.c_double(dt), VECTOR(*q), VECTOR(*tau), q_ref, qd_ref, ctypes.byref(share))
        self.library.swing_step(*arguments)
        return np.array(q_ref), np.array(qd_ref), share.value

    def read(self, many=4096):
        rows = (Row * many)()
        return rows[: self.library.swing_read(self.state, rows, many)]

    @property
    def status(self):
        return STATUS[self.head.status]

    @property
    def reason(self):
        return REASONS[self.head.reason]


def follow(player, dt, steps, q, jump=None):
    """A device that is where its reference is; `jump` is added to its position. The references, and shares."""
    q, found = np.array(q, dtype=float), []
    for _ in range(steps):
        q_ref, qd_ref, share = player.step(dt, q if jump is None else q + jump)
        q = q_ref
        found.append((q_ref, qd_ref, share))
        if player.status in ("done", "stopped"):
            break
    return [np.array(each) for each in zip(*found, strict=True)]


@pytest.mark.parametrize("speed", [1.0, 0.25])
def test_references_are_the_motion(library, speed):
    player = Player(library)
    assert player.start(1, speed, MOTIONS[1].q[0]) == "approaching"
    refs, rates, shares = follow(player, 1e-3, 40_000, MOTIONS[1].q[0])
    assert player.status == "done"
    assert (np.diff(shares) >= 0).all()
    assert shares[0] < 0.01
    assert shares[-1] == 1.0
    rows = player.read()  # the first ones, up to the size of the buffer
    playing = [row for row in rows if row.plan >= 0]
    assert len(playing) > 400
    wanted = CubicHermiteSpline(MOTIONS[1].t, MOTIONS[1].q, MOTIONS[1].qd)
    found = np.array([list(row.q_ref) for row in playing])
    np.testing.assert_allclose(found, wanted([row.plan for row in playing]), atol=1e-12)
    np.testing.assert_allclose(np.diff([row.plan for row in playing]), speed * 1e-3, rtol=1e-9)
    np.testing.assert_allclose(refs[-1], MOTIONS[1].q[-1], atol=1e-12)
    np.testing.assert_allclose(np.gradient(refs, 1e-3, axis=0)[2:-2], rates[2:-2], atol=0.02)


def test_from_elsewhere_it_goes_to_the_first_pose_slowly(library):
    player, away = Player(library), MOTIONS[0].q[0] + np.array([0.15, -0.1])
    player.start(0, 0.5, away)
    refs, rates, _ = follow(player, 1e-3, 400, away)
    assert player.status == "approaching"
    np.testing.assert_allclose(refs[0], away, atol=1e-6)
    allowed = 0.5 * 0.2 * max(np.abs(motion.qd).max() for motion in MOTIONS)
    assert np.abs(rates).max() <= allowed * (1 + 1e-9)
    follow(player, 1e-3, 40_000, refs[-1])
    assert player.status == "done"


def test_on_the_bench_it_excites_and_records_every_step(library):
    """PD on the player's references, the share as soft start: what is recorded is the motion, each step once."""
    model, player, recorded = two_links(), Player(library), []

    class Law:
        def begin(self, dt):
            state = {"last": None}

            def step(_t, qa):
                if state["last"] is None:
                    player.start(0, 1.0, qa)
                    state["last"], state["tau"] = qa, np.zeros(2)
                rate, state["last"] = (qa - state["last"]) / dt, qa
                q_ref, qd_ref, share = player.step(dt, qa, state["tau"])
                recorded.extend(player.read(3))
                state["tau"] = share * (np.array(KP) * (q_ref - qa) + np.array(KD) * (qd_ref - rate))
                return state["tau"]

            return step

    controller = bench.Controller((0.0,), (0.0,), rate_hz=RATE, tracking_limit=np.inf)
    chi = true_parameters(model, **FRICTION)
    setup = bench.Setup(
        model, chi, controller, bench.Encoders(), bench.Amplifiers(), physics=bench.Physics(5e-4), law=Law()
    )
    q = np.tile(MOTIONS[0].q[0] + np.array([0.05, -0.05]), (round(6.0 * RATE), 1))
    still = bench.Trajectory(setup.dt, q, np.zeros_like(q), np.zeros_like(q))
    made = bench.simulate(setup, still, np.random.default_rng(0))
    assert player.status == "done", player.reason
    assert [row.number for row in recorded] == list(range(len(recorded)))
    playing = [row for row in recorded if row.plan > 0 and STATUS[row.status] == "playing"]
    plan, ref = np.array([row.plan for row in playing]), np.array([list(row.q_ref) for row in playing])
    for j in range(JOINTS):
        np.testing.assert_allclose(ref[:, j], np.interp(plan, MOTIONS[0].t, MOTIONS[0].q[:, j]), atol=2e-3)
    error = np.array([np.subtract(row.q, row.q_ref) for row in playing])
    assert np.abs(error).max() < 0.1
    q_recorded = np.array([list(row.q) for row in recorded])
    assert np.ptp(q_recorded, axis=0).min() > 0.5
    assert len(made) >= len(recorded)


@pytest.mark.parametrize("fault", ["tracking", "range", "fast", "late", "finite", "asked"])
def test_it_stops_at_every_fault(library, fault):
    player, start = Player(library), MOTIONS[0].q[0]
    player.start(0, 1.0, start)
    refs, _, shares = follow(player, 1e-3, 2000, start)
    assert player.status == "playing"
    q, dt = refs[-1].copy(), 1e-3
    if fault == "tracking":
        for _ in range(4000):  # a device that stays behind
            player.step(dt, q)
    elif fault == "range":
        wide = MOTIONS[0].q.max(axis=0).max() + 0.5
        for _ in range(3000):
            q = q + np.clip([wide, 0.0] - q, -1.5e-3, 1.5e-3) * [1, 0]
            player.step(dt, q)
    elif fault == "fast":
        for k in range(60):
            player.step(dt, q + np.array([0.0, 6e-3 * k]))
    elif fault == "late":
        player.step(0.05, q)
    elif fault == "finite":
        player.step(dt, [np.nan, 0.0])
    else:
        library.swing_stop(player.state)
    assert player.status == "stopped"
    expected = {"range": ("range", "tracking", "fast"), "fast": ("fast", "tracking")}.get(fault, (fault,))
    assert player.reason in expected
    down = [player.step(dt, q)[2] for _ in range(600)]
    assert (np.diff(down) <= 0).all()
    assert down[-1] == 0.0
    assert down[0] == 0.0 or fault not in ("finite",)
    assert shares[-1] == 1.0


def test_rows_that_do_not_fit_show_as_a_gap(library):
    player, start = Player(library), MOTIONS[0].q[0]
    player.start(0, 1.0, start)
    refs, _, _ = follow(player, 1e-3, 1500, start)
    first = player.read()
    assert [row.number for row in first] == list(range(1024))
    follow(player, 1e-3, 10, refs[-1])
    assert [row.number for row in player.read()] == list(range(1500, 1510))


def test_what_cannot_be_played(library, tmp_path):
    player = Player(library)
    for motion, speed in ((2, 1.0), (-1, 1.0), (0, 0.0), (0, 1.5)):
        assert player.start(motion, speed, (0.0, 0.0)) == "stopped"
        assert player.reason == "no such"
    with pytest.raises(errors.SettingError, match="a player is a C file"):
        write_player(tmp_path / "x.h", MOTIONS)
    with pytest.raises(errors.SettingError, match="found 0"):
        write_player(tmp_path / "x.c", ())
    with pytest.raises(errors.SettingError, match="power of two"):
        PlayerSettings(records=1000)
    with pytest.raises(errors.SettingError, match="tracking"):
        PlayerSettings(tracking=0.0)


def test_the_command_writes_a_player_that_compiles(tmp_path):
    within = ("--centre", "0,0.2,0.3", "--stroke", "0.6,0.4,0.4", "--speed", "3", "--max-evaluations", "20")
    files = ("--out", str(tmp_path / "x.toml"), "--player", str(tmp_path / "2 hands.c"), "--rate-hz", "100")
    done = CliRunner().invoke(app, ["excite", "phantom_premium_15", *within, *files])
    assert done.exit_code == 0, done.output
    command = ["cc", *STRICT, "-DMOTION_2_HANDS_STDIO", "-c", "-o", str(tmp_path / "x.o"), str(tmp_path / "2 hands.c")]
    subprocess.run(command, check=True)
    done = CliRunner().invoke(app, ["excite", "phantom_premium_15", *within, *files[:2], "--player", "x.h"])
    assert done.exit_code == 2
    assert "--player" in done.stderr
