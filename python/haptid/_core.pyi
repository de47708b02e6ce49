"""The compiled core. All arrays are float64 and row-major; samples run along the last axis."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Residues = NDArray[np.int64]
CutFrame = tuple[int, Sequence[float], Sequence[float]]

__version__: str

def backends() -> list[str]:
    """Names of the instruction sets this machine can run, fastest first."""

def echelon(matrices: Residues, candidates: int, prime: int) -> tuple[Residues, list[int]] | None:
    """Reduced row echelon forms modulo a prime, (n, rows, columns), and the pivots' columns, at most `candidates`.

    Rows after the pivots are undefined. None where the matrices differ in their pivots.
    """

def exact_rows(
    parent: Sequence[int],
    prismatic: Sequence[bool],
    placements: Residues,
    motion: Residues,
    rates: Residues,
    base: Residues,
    samples: int,
    prime: int,
) -> Residues:
    """Torques of the active joints by XX XY XZ YY YZ ZZ MX MY MZ M of all links, (states, active, 10 links).

    Placements are (joints, sets, 4, 4), each for `samples` states in a row; cosine, sine, slide, velocity and
    acceleration (5, joints, states); rates by active joint (joints, states, active); acceleration of the base less
    gravity (states, 3). All are residues of the prime.
    """

def real_rows(
    parent: Sequence[int],
    prismatic: Sequence[bool],
    placements: Array,
    motion: Array,
    rates: Array,
    base: Array,
    samples: int,
) -> Array:
    """The same in floating point."""

def triangles(rows: Array) -> Array:
    """The upper triangles R with R'R = rows'rows, (stacks, columns, columns), of rows (stacks, many, columns)."""

def filter_both_ways(sections: Array, channels: Array, padding: int) -> Array:
    """Channels, (channels, n), each through second-order sections of its own, (channels, sections, 6), both ways.

    Both ends are extended by `padding` samples of the signal turned about its end point; n must be larger.
    """

def decimate(channels: Array, taps: Array, decimation: int) -> Array:
    """Sums of a window's samples weighted by the taps, the oldest first, (channels, n) to (channels, rows).

    Windows are as long as the taps, and begin every `decimation` samples.
    """

def extreme_eigenvalues(matrix: Array) -> tuple[float, float]:
    """The smallest and the largest eigenvalue of a symmetric matrix, to rounding of the larger in magnitude.

    NaN where an entry is not finite.
    """

def smooth_condition(matrix: Array, power: int) -> tuple[float, Array] | None:
    """log(tr C^power tr C^-power) / (2 power) of a positive definite matrix, and its derivative by C, (k, k).

    None where C is not positive definite, or nearly singular.
    """

def torque_of_play(
    dt: float,
    position: Array,
    velocity: Array,
    acceleration: Array,
    inertia: Array,
    rest: Array,
    dry: float,
    viscous: float,
    plays: Array,
) -> Array:
    """Torque of a motor with its link in play less that without, (plays, samples), N m or N; zero at the last sample.

    Args:
        dt: sampling period, s.
        position, velocity, acceleration: of the motor, (samples,), SI.
        inertia: that it turns, (samples,).
        rest: torque without that of inertia and friction, (samples,), N m or N.
        dry, viscous: friction of motor and link, SI.
        plays: size from flank to flank, shares of the link in inertia and friction, (plays, 3).
    """

def end_effector_dynamics(
    mechanism: Mechanism,
    position: Array,
    loops: Array | None,
    link: int,
    point: Sequence[float],
    chi: Array,
    rows: Sequence[int],
) -> Array:
    """Jacobian of a point of a link, and the mass matrix, (samples, (rows + coordinates) * coordinates).

    Positions of the coordinates are (coordinates, samples), loops and chi as for `mass_matrix`. Rows are of the
    velocity in the base frame: 0 to 2 linear, 3 to 5 angular.
    """

def apparent_mass(
    mechanism: Mechanism,
    position: Array,
    loops: Array | None,
    link: int,
    point: Sequence[float],
    chi: Array,
    rows: Sequence[int],
    moving: Sequence[int],
    worst: float,
    spread: Array,
) -> tuple[Array, Array, Array, Array]:
    """Principal values of (J A^-1 J')^-1 at every pose; arguments as for `end_effector_dynamics`.

    The condition number of J, (samples,); r = min(rows, moving) masses, largest first, (samples, r); their directions,
    (samples, r, rows); the upper triangle of their covariance from spread, (columns, any), whose columns' outer
    products are summed, (samples, r (r + 1) / 2), or (samples, 0) without columns. NaN, but for the condition number,
    where that is above `worst`, or A is not positive definite.
    """

class Loops:
    """A tree and the joints cut out of its loops.

    A cut is (kind, frame, twin), each frame (link, -1 for the base; rotation row by row; translation). Gaps of a
    "revolute" joint are the distance of the origins and `size` times the difference of the z axes; of a "prismatic" one
    the distance along the twin's x and y, and `size` times the differences of the x and z axes, by component; of a
    "spherical" one the distance of the origins.
    """

    def __new__(
        cls,
        parent: Sequence[int],
        rotation: Array,
        translation: Array,
        prismatic: Sequence[bool],
        cuts: Sequence[tuple[str, CutFrame, CutFrame]],
        size: float,
    ) -> Loops:
        """Joints as for a mechanism. ValueError where the parts do not fit."""

    def gaps(self, q: Array) -> tuple[Array, Array]:
        """Gaps, (samples, m), and their Jacobian, (samples, m, joints), at joint positions (samples, joints)."""

    def close(self, q: Array, unknown: Sequence[int], steps: int, settled: float) -> Array:
        """The unknown joints moved until the cuts are as closed as they can be, (samples, joints).

        Damped Gauss-Newton steps, at most so many (10 000 may be asked for), until one is no longer than `settled`.
        """

class Branch:
    """One of the ways in which loops close: that which leads from a start pose, without a singular pose, to others."""

    def __new__(
        cls,
        loops: Loops,
        active: Sequence[int],
        unknown: Sequence[int],
        constant: Array,
        offset: Array,
        start: Array,
        varying: NDArray[np.bool_],
        closed: float,
        singular: float,
    ) -> Branch:
        """Joints that cuts do not settle are at constant @ qa + offset; the unknown ones begin at start.

        Rates that do not vary are taken as zero. A pose is closed where no gap exceeds `closed` times the size, and
        settled where the least singular value of the gaps' Jacobian by the unknown joints, its columns of unit
        length, exceeds `singular`. ValueError where the parts do not fit.
        """

    def positions(self, qa: Array) -> tuple[Array, tuple[int, Array] | None]:
        """All joints, (samples, joints), where the active ones go through (samples, active).

        Beside them the first sample that is not reached, and the last closed pose on the way there, (joints,).
        """

    def follow(self, qa: Array, qda: Array) -> tuple[Array, Array, Array, tuple[int, Array] | None]:
        """The same with rates by the active joints, and their change with time, (samples, joints, active)."""

    def reach(self, qa: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Poses on the straight way from the start, (samples, joints), and whether each was reached.

        Where one is not, the last closed pose on the way to it stands in its place.
        """

class Mechanism:
    """A tree or closed chain, ready for the kernels.

    Joint frames are in normal form (each link turns about, or slides along, its own z) and all joints follow the
    coordinates, q = rates @ c + offset. Columns are ten for each link (XX XY XZ YY YZ ZZ MX MY MZ M), then one for
    each term.

    Where rates are given with every sample, `loops` (channels, samples) has for each joint with such rates, in order,
    its position, those rates, and their rates of change with time.
    """

    def __new__(
        cls,
        parent: Sequence[int],
        rotation: Array,
        translation: Array,
        prismatic: Sequence[bool],
        gravity: Sequence[float],
        rates: Array,
        offset: Array,
        terms: Sequence[tuple[str, Array, float, float, float, float]],
        backend: str | None = None,
        given: NDArray[np.bool_] | None = None,
        on: Sequence[int | None] | None = None,
    ) -> Mechanism:
        """Parents come before children, -1 is the base; rotation (n, 3, 3), translation (n, 3), rates (n, coordinates).

        A term is (kind, weights (coordinates,), offset, a, b, c); it acts on the joint that `on` names, where it names
        one, in place of weights and offset. `given` are the rates that come with every sample, (n, coordinates).
        ValueError where the parts do not fit.
        """

    @property
    def coordinates(self) -> int:
        """Number of coordinates, and of torque rows."""

    @property
    def columns(self) -> int:
        """Number of columns."""

    def regressor(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        external: Array,
        columns: Sequence[int],
        loops: Array | None = None,
        out: Array | None = None,
    ) -> Array:
        """The chosen columns of every coordinate's torque, (coordinates, columns, samples).

        Written into `out`, row-major and of this shape, where it is given: new memory costs more than the numbers. What
        an earlier call returned begins with a line of the caches, and is written fastest.
        """

    def torque(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        external: Array,
        chi: Array,
        loops: Array | None = None,
    ) -> Array:
        """Torque of the parameters of all columns, (coordinates, samples), by recursion.

        chi is (columns,), or (sets, columns): samples are shared out among the sets evenly, in order. A column that the
        caller makes is not read where its parameter is zero.
        """

    def mass_matrix(self, position: Array, chi: Array, loops: Array | None = None) -> Array:
        """Mass matrix of links and rotors, (samples, coordinates, coordinates); chi as for `torque`."""

    def acceleration(
        self,
        position: Array,
        velocity: Array,
        torque: Array,
        external: Array,
        chi: Array,
        loops: Array | None = None,
    ) -> tuple[Array, int | None]:
        """Acceleration under a torque (coordinates, samples), of the same shape; chi as for `torque`.

        Beside it the first sample whose mass matrix is not positive definite, if there is one.
        """

    def momentum_regressor(
        self,
        position: Array,
        velocity: Array,
        external: Array,
        columns: Sequence[int],
        loops: Array | None = None,
    ) -> Array:
        """The chosen columns of every coordinate's momentum, and of the rest of its torque beside d/dt momentum.

        Shape (2, coordinates, columns, samples). Neither has accelerations: regressor = d/dt momentum + rest.
        """

    def momentum(
        self, position: Array, velocity: Array, external: Array, chi: Array, loops: Array | None = None
    ) -> Array:
        """Momentum, and the rest of the torque beside its rate of change, (2, coordinates, samples).

        chi as for `torque`.
        """

    def inner_products(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        external: Array,
        columns: Sequence[int],
        factors: Array,
        loops: Array | None = None,
    ) -> Array:
        """Inner products of the chosen columns over the samples and all coordinates' torques, (columns, columns).

        Entries of a coordinate's columns are multiplied by `factors`, (coordinates, columns), first.
        """

    def form_slopes(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        external: Array,
        columns: Sequence[int],
        form: Array,
        factors: Array,
        loops: Array | None = None,
    ) -> Array:
        """Slopes of the sum over coordinates of y' F y by every channel, at each sample, (channels, samples).

        y are the chosen columns of a coordinate's torque, times their `factors`, (coordinates, columns), and F is the
        form, (columns, columns). Channels are positions, velocities, accelerations, external and loops, in this order.
        """

    def torque_slopes(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        external: Array,
        columns: Sequence[int],
        chi: Sequence[float],
        loops: Array | None = None,
    ) -> Array:
        """Slopes of the chosen columns' torque by every channel, (coordinates, channels, samples)."""

    def reach(self, columns: Sequence[int]) -> list[list[bool]]:
        """Which of the chosen columns each coordinate's row can reach."""

    def reduce(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array | None,
        external: Array,
        torque: Array,
        columns: Sequence[int],
        taps: Array,
        decimation: int,
        first: int,
        rows: int,
        block: int,
        weights: Array,
        slope: Array | None = None,
        loops: Array | None = None,
    ) -> list[tuple[list[int], Array]]:
        """Rows filtered, decimated, weighted, and folded into one triangle per coordinate and block.

        Row r is centred on sample `first + r * decimation`; weights are (coordinates, rows). Returns for each
        coordinate the chosen columns it reaches and its triangles [R z; 0 rest], (blocks, reached + 1, reached + 1).
        Without accelerations a row is `slope` over momenta plus `taps` over the rest; torques always pass `taps`.
        """
