"""`haptid report`, `compare`, `characterise`, `datasheet`, `redesign` and `export`."""

from __future__ import annotations

from pydantic import Field

from haptid.cli.outputs.tables import Interval, OutputTable
from haptid.results.schema import Number, ResultUse


class ChangeOutput(OutputTable):
    """A parameter of two results."""

    name: str
    unit: str
    first: Number
    second: Number
    difference: Number
    low: Number = Field(description="lower end of the 95 % interval of the difference")
    high: Number
    p: Number = Field(description="of no difference, corrected for multiple testing (Holm)")
    differs: bool


class PairOutput(OutputTable):
    first: str
    second: str
    sentences: list[str]
    rows: list[ChangeOutput]


class ReportOutput(OutputTable):
    """A page that was written."""

    page: str = Field(description="its path")
    pairs: list[PairOutput] = Field(description="each later result against the first")


class ComparedParameterOutput(OutputTable):
    name: str
    unit: str
    value: list[Number] = Field(description="of each result")
    se: list[Number]
    dof: list[Number]
    common: Number = Field(description="value if all results have the same")
    p: Number
    p_holm: Number = Field(description="corrected for multiple testing")
    differs: bool
    detectable: Number = Field(description="smallest change that is found with 80 % power")


class JointTestOutput(OutputTable):
    """A change that several parameters show together."""

    name: str
    directions: int = Field(description="degrees of freedom of the numerator")
    f: Number
    dof: list[Number]
    p: Number
    p_holm: Number
    differs: bool
    distance: Number
    detectable: Number


class JointTestsOutput(OutputTable):
    tests: list[JointTestOutput]
    equality_p: Number = Field(description="of equal parameters altogether")
    notes: list[str]


class SlopeOutput(OutputTable):
    """Drift of a parameter."""

    name: str
    slope: Number = Field(description="per unit of time")
    se: Number
    dof: Number
    conf_int: Interval
    p: Number
    p_holm: Number
    drifts: bool
    bent: bool = Field(description="whether a straight line does not fit")


class DriftOutput(OutputTable):
    unit: str
    times: list[float]
    parameters: list[SlopeOutput]


class CompareOutput(OutputTable):
    """Results compared."""

    results: list[str]
    confidence: float = Field(description="joint confidence level for all parameters")
    parameters: list[ComparedParameterOutput]
    joint: JointTestsOutput | None
    notes: list[str]
    drift: DriftOutput | None = Field(default=None, description="with --times")


class FigureOutput(OutputTable):
    name: str
    unit: str
    values: list[Number] = Field(description="one for each pose")
    conf_int: list[Interval] | None = Field(description="95 % intervals; null where no covariance is known")


class CharacteriseOutput(OutputTable):
    """Figures at the handle."""

    device: str
    poses: dict[str, list[float]] = Field(description="positions of the active joints, rad or m")
    figures: list[FigureOutput]
    notes: list[str]


class SheetRowOutput(OutputTable):
    group: str
    name: str
    value: Number = Field(description="at the median of the workspace, or of the whole")
    unit: str
    method: str = Field(description="how it was found, or why it is not known")
    low: Number = Field(description="of the range over the workspace")
    high: Number
    conf_int: Interval | None = Field(description="95 % interval of the value")


class CounterweightOutput(OutputTable):
    link: str
    mass: Number = Field(description="kg")
    com: tuple[float, float, float] = Field(description="in the link frame of the device file, m")


class BalanceOutput(OutputTable):
    price: Number = Field(description="of the search; null of weights that were given")
    weights: list[CounterweightOutput]
    static_before: Number = Field(description="root mean square over poses and joints, N m or N")
    static_after: Number
    mass_before: Number = Field(description="largest effective mass, mean over the poses, kg")
    mass_after: Number


class MotorOptionOutput(OutputTable):
    name: str
    torque: float = Field(description="factor of the present motors' torques")
    inertia: float = Field(description="factor of their rotor inertia")


class DriveChangeOutput(OutputTable):
    ratios: list[float] = Field(description="factors of the motors' transmission ratios")
    length: float = Field(description="factor of all lengths")
    motor: MotorOptionOutput
    mass: Number = Field(description="largest effective mass, median over the poses, kg")
    force: Number = Field(description="in the worst direction, median over the poses, N")
    poses: int = Field(description="over which the medians are")


class RedesignOutput(OutputTable):
    """Counterweights, and changes of motors, gears and lengths."""

    counterweights: list[BalanceOutput]
    present: DriveChangeOutput | None = Field(description="without changes; null where rotors or limits are not known")
    front: list[DriveChangeOutput] = Field(description="changes that no other one beats, by mass")
    chosen: DriveChangeOutput | None = Field(description="the least change that reaches what is wanted")
    missing: list[str] = Field(description="why a part is empty")


class WrittenOutput(OutputTable):
    folder: str
    files: list[str]
    verdict: str


class ExportOutput(OutputTable):
    """Files for other programs."""

    formats: dict[str, WrittenOutput]
    verdict: list[ResultUse]
