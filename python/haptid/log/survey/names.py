"""What a channel's name says: its words, its quantity, and the unit that is written in it."""

from __future__ import annotations

import re

from haptid.log.survey.channels import Quantity
from haptid.log.units import known_unit

# Words of channels' names, in the languages of the laboratories that publish logs.
_VELOCITY = frozenset({"qd", "dq", "dqi", "dqs", "qds", "jv", "angvel", "vel", "velo", "velocity", "velocities",
                       "speed", "omega", "rpm", "tacho", "vitesse", "geschwindigkeit", "drehzahl",
                       "velocidad"})  # fmt: skip
CURRENT_WORDS = frozenset({"current", "currents", "curr", "cur", "i", "amps", "iq", "strom", "courant", "corriente",
                      "corrente"})  # fmt: skip
_VOLTAGE = frozenset({"voltage", "voltages", "volt", "volts", "vm", "vq", "uq", "spannung"})
_DUTY = frozenset({"pwm", "duty"})
_TORQUE = frozenset({"tau", "taus", "torque", "torques", "trq", "torq", "tor", "tq", "effort", "efforts", "eff",
                     "moment", "drehmoment", "couple", "coppia", "tao", "taos"})  # fmt: skip
_EFFORT = frozenset({"effort", "efforts", "eff"})  # the field of a message, whatever is in it
_FORCE = frozenset({"load", "loads", "force", "kraft", "u", "mt", "ctrl"})
_POSITION = frozenset({"q", "qi", "qm", "ql", "jp", "pos", "position", "positions", "ang", "angle", "angles", "theta",
                       "enc", "encoder", "pot", "potentiometer", "winkel", "lage", "weg", "posicion",
                       "posizione", "qs", "thetas"})  # fmt: skip
# Names of joints, of angles of any kind, and positions in the table of a KUKA arm's FRI client.
_ANGLE = frozenset({"th", "phi", "joint", "j", "axis", "mp", "displacement", "stroke"}) | {"ticks", "counts", "pulses"}
# What moves straight: its positions are lengths.
_STRAIGHT = frozenset({"cart", "slider", "slide", "carriage", "piston", "rail", "prismatic", "linear", "gantry",
                            "displacement", "stroke", "wagen", "schlitten", "kolben", "weg"})  # fmt: skip
# In this order: a word that tells the quantity, before one that may belong to any.
QUANTITY_WORDS: tuple[tuple[Quantity, frozenset[str]], ...] = (
    ("velocity", _VELOCITY),
    ("torque", _TORQUE | CURRENT_WORDS - {"i"}),
    ("torque", _VOLTAGE),
    ("velocity", frozenset({"v"})),
    ("position", _POSITION),
    ("torque", _FORCE | _DUTY | {"i"}),
    ("position", _ANGLE),
)
# Settings, differences from what is wanted, what is no joint's, and what is no motor's.
NEITHER = frozenset({"limit", "limits", "min", "max", "gain", "gains", "error", "err", "tcp", "cartesian", "tip", "ee",
                      "eef", "orientation", "quaternion", "quat", "pose", "bus", "vbus", "vdc", "supply", "battery",
                      "temp", "temperature", "temperatures", "power", "mode", "modes", "status", "window", "scaling",
                      "fraction", "ratio", "covariance", "cov", "variance", "diff", "deviation", "lag", "droop",
                      "direct", "acc", "accel", "acceleration", "accelerations", "beschleunigung",
                      "ddq", "qdd", "ddqs", "qdds"})  # fmt: skip
# Groups of settings, of which nothing is recorded.
_SETTINGS = frozenset({"parameter", "parameters", "params", "param", "setting", "settings", "config"})
# Positions of an encoder, as it counts them.
COUNTED_WORDS = frozenset({"ticks", "counts", "count", "pulses"})
# Letters of angles, each of another one in a log.
_LETTERS = frozenset({"alpha", "beta", "gamma", "theta", "phi", "psi"})
# Names of joints and not only of their positions.
_JOINT = frozenset({"joint", "j", "axis"})
# `joint_control_output` in the tables of Universal Robots, a current; outputs of other controllers are of any unit.
_OUTPUT = frozenset({"joint", "control", "output"})
# A command of nothing in particular stands for a torque.
COMMAND_WORDS = frozenset({"command", "commands", "commanded", "cmd"})
_TIME = frozenset({"t", "ts", "time", "times", "timestamp", "stamp", "date", "datetime", "sec", "secs", "seconds",
                   "elapsed", "zeit", "temps", "tempo", "tiempo",
                   "millis", "micros", "utime", "tick", "ticks", "milliseconds", "microseconds",
                   "nanoseconds"})  # fmt: skip
_TIME_UNIT = {"s": "s", "ms": "ms", "msec": "ms", "millis": "ms", "us": "us", "usec": "us", "micros": "us",
              "utime": "us", "ns": "ns", "nsec": "ns", "milliseconds": "ms", "microseconds": "us",
              "nanoseconds": "ns"}  # fmt: skip

# Words of scripts without capitals, inside longer ones: Chinese, Japanese and Korean, and Russian.
_FOREIGN = {
    "position": ("位置", "角度", "关节角", "関節角", "위치", "각도", "угол", "положение"),
    "velocity": ("速度", "转速", "속도", "скорость"),
    "torque": ("力矩", "扭矩", "转矩", "トルク", "토크", "момент"),
    "current": ("电流", "電流", "전류", "ток"),
    "acceleration": ("加速度", "가속도", "ускорение"),
    "desired": ("期望", "目标", "指令", "给定", "目標", "목표"),
    "time": ("时间", "時間", "时刻", "시간", "время"),
    "joint": ("关节", "関節", "관절", "сустав"),
}
_BY_LENGTH = sorted(((own, word) for word, all_ in _FOREIGN.items() for own in all_), key=lambda x: -len(x[0]))
_FOREIGN_WORD = re.compile("|".join(own for own, _ in _BY_LENGTH), re.I)
# A run of capitals, or letters with or without a capital before them: `MotorCur`, `TCPForce`.
_TOKEN = re.compile(r"[^\W\d_a-z]+(?![a-z])|[^\W\d_a-z]?[^\W\d_A-Z]+")
# Words that are written together in lower case or in capitals: `posact`, `tauest`, `jpos`.
_GLUED = re.compile(
    r"(?:(?P<first>joint|motor|gelenk|achs)(?=act|meas|cmd))?"
    r"(?P<before>act|actual|ist|soll|set|meas|measured|msr|des|ref|cmd|joint|motor|gelenk|achs|[jqm])?"
    r"(?P<word>pos|position|vel|velo|velocity|tau|trq|tor|torque|cur|current|angle|ang|winkel|lage|drehmoment|moment|strom"
    r"|geschwindigkeit|drehzahl)s?"
    r"(?P<after>act|actual|ist|soll|set|meas|msr|des|ref|cmd|est|fb|fbk|real)?"
)
# Currents and voltages of a motor's field-oriented control: `i_q`, `Vq` act, those of the direct axis or in the frame
# of the stator do not; a capital V of a motor is no velocity.
_FIELD = re.compile(r"(?<![A-Za-z])(?P<kind>[iIuUvV])_?(?P<axis>[qQ]|[dD]|alpha|beta)(?![A-Za-z])")
# The number of a servo on a bus beside a quantity, `ID1_Present_Position`; alone `id1` is a current.
_IDENTITY = re.compile(r"(?i:(?<![a-z])id[_ ]?\d+(?=[^a-z\d]+[a-z]))|(?i:(?<=[a-z][_ ./])id[_ ]?\d+(?![a-z\d]))")
# The measured coordinate of a numbered axis, `X1_meas`; a state of a controller is called `x1` too.
_AXIS = re.compile(r"(?<![A-Za-z])[xX](?=_?\d+_(?:meas|measured|msr|act|actual|ist|fb|fbk)(?![a-z]))")
# The number of an axis behind its point.
_AXIS_NUMBER = re.compile(r"[A-Za-z]\d{1,2}")
_VOLTS = re.compile(r"(?<![A-Za-z])V(?=_?(?:motor|mot|m|in|arm|cmd|act)(?![a-z]))")
# Before one of these words "current" means the present value.
_PRESENT = re.compile(
    r"current(?=[_ ]?(?:joint|motor)?[_ ]?(?:angle|pos|theta|vel|speed|torque|effort|state|pose|orient))", re.I
)
# Rates in names of positions: `D_Theta`, `dTheta`, `theta_dot`, `dataDotQ`, `ddotq`; `q_d` is what is desired.
_RATE = re.compile(
    r"(?i:^d(?P<second>d)?_)|^d(?P<capital>d)?(?=[A-Z]|theta|phi|pos|angle|th\d*$)|(?i:(?P<dot>d)?dot(?=[^a-z]|$))"
    r"|(?<![A-Z])(?P<camel>D)?Dot(?=[A-Z])|(?i:(?<![a-z])(?P<small>d)?dot(?=q(?![a-z])))"
)
# Errors of a controller: `e_q1`, `e_vel`; `E_pos` is of an axis too.
_ERROR = re.compile(r"e_(?=[A-Za-z])")
# A word of angles behind another one: part of a joint's name where the quantity is said beside it.
ANGLE = re.compile(r"(?i:(?<=[a-z0-9])[ _]angle(?![a-z]))")
_ARRAY_ELEMENT = re.compile(r"^(?P<array>.*)\[(?P<element>[^\[\]]*)\]$")
# An element of an array of arrays.
NESTED = re.compile(r"(?P<array>.*)\[(?P<outer>\d+)\]\[(?P<inner>\d+)\]")
_BRACKETED = re.compile(r"(?<!\s)(?P<space>\s*+)[\[(](?P<unit>[^\[\]()]*)[\])]\s*$")
_OTHER_UNITS = re.compile(r"%|rpm|°C|(?:rad|deg|°|m|mm|1|U|rev|turns?)\s?/\s?\S+")
# A unit and a number, and units that such a name seldom means: a counter, or a number of turns, is no angle by itself.
_UNIT_AND_NUMBER = re.compile(r"(?P<unit>[^\W\d_][^\d]*[^\W\d_])[_ .]?\d+")
_RARELY_ALONE = frozenset({"counts", "turn"})
# `Torque / Nm`, `torque in Nm`, `Torque Nm`; a single letter after a space is more often a name.
_WRITTEN = re.compile(r"(?<=\w)(?:\s?/\s?(?P<slash>[^\s/.]+)|\s+in\s+(?P<stated>\S+)|\s+(?P<bare>[^\s\w]|\S{2,}))$")


def unit_apart(name: str) -> tuple[str, str]:
    """A name without the unit that is written at its end, and that unit; empty where there is none."""
    if match := _BRACKETED.search(name):
        unit = match["unit"].strip()
        # A joint's name is a letter too: `position[a]` is not in A; behind a space, `time [h]`, it is a unit.
        letter = len(unit) == 1 and unit.islower() and unit not in ("m", "s") and not match["space"]
        if not (unit.isdecimal() or letter) and (match["space"] or known_unit(unit) or _OTHER_UNITS.fullmatch(unit)):
            return name[: match.start()], unit
        return name, ""
    match = None if name.startswith("/") or name.count("/") > 1 else _WRITTEN.search(name)
    unit = next((part for part in match.groups() if part), "") if match else ""
    return (name[: match.start()].rstrip(), unit) if match and known_unit(unit) else (name, "")


def only_unit(name: str) -> tuple[Quantity, str] | None:
    """Quantity and unit of a channel that is called as its unit, with a number: `rad1`, `nm_2`, `rad_s_1`."""
    match = _UNIT_AND_NUMBER.fullmatch(name)
    known = (
        known_unit(match["unit"].replace("_", "/")) or known_unit(match["unit"].replace("_", " ")) if match else None
    )
    return known if known and known[0] != "time" and known[1] not in _RARELY_ALONE else None


def element_of(name: str) -> re.Match[str] | None:
    """The array and the element of a name such as `position[2]`; None where a unit is in the brackets."""
    match = _ARRAY_ELEMENT.match(name)
    return match if match and (match["element"].isdecimal() or unit_apart(name)[0] == name) else None


def base_of(name: str) -> str:
    """The name without its unit and its element."""
    match = element_of(name)
    return _PRESENT.sub("", match["array"] if match else unit_apart(name)[0])


def english(name: str) -> str:
    """The name with known words of other scripts in English."""
    return name if name.isascii() else _FOREIGN_WORD.sub(lambda m: f" {dict(_BY_LENGTH)[m[0].lower()]} ", name).strip()


def words_of(name: str) -> frozenset[str]:
    """Words of a name in lower case, also of those that are written together."""
    words: set[str] = set()
    name = _IDENTITY.sub(" ", english(name))
    name = _AXIS.sub("pos", _VOLTS.sub("voltage_", _FIELD.sub(_of_field, name)))
    for token in _TOKEN.findall(name):
        glued = _GLUED.fullmatch(token.lower())
        words.update(part for part in glued.groups() if part) if glued else words.add(token.lower())
    return frozenset(words)


def _of_field(match: re.Match[str]) -> str:
    """`iq`, `vq` or `uq`; of another axis a word that is no quantity."""
    return f"{match['kind']}q".lower() if match["axis"] in "qQ" else "direct"


def last_part(name: str) -> str:
    """The last part of a path, as of a field of a topic."""
    return re.split(r"[/.]", name)[-1]


def is_quantity(part: str) -> bool:
    """Whether a part of a name says a quantity and nothing else."""
    return any(words_of(part) <= known for _, known in QUANTITY_WORDS)


def quantity_of(name: str) -> Quantity:
    """By the words of a name's last part, else by all of them; "joint" alone names a position, and no topic's field."""
    if name.lower() == "us":  # the inputs beside `ts` and `qs`; elsewhere microseconds
        return "torque"
    last = words_of(last_part(name))
    parts = re.split(r"[/.]", name)
    if parts[-2:-1] and is_quantity(parts[-2]):
        last = words_of(ANGLE.sub("", parts[-1]))
    if last & NEITHER or _ERROR.match(last_part(name)) or words_of(name) & _SETTINGS:
        return "other"
    rate = _RATE.search(name.rpartition(".")[2])
    if rate:
        name = _RATE.sub(" ", name.rpartition(".")[2])
        last = words_of(name)
    words = words_of(name) or last
    if len(parts) > 1 and _AXIS_NUMBER.fullmatch(parts[-1]) and not is_quantity(parts[-1]):
        last = words_of(parts[-2])  # `$AXIS_ACT.A1` of a KUKA controller
    if last >= _OUTPUT and not last & (_POSITION | _VELOCITY):
        return "torque"
    named = frozenset() if "states" in last else last & _JOINT  # those of joints are their velocities and torques too
    for known_words in (last - _JOINT, words - _JOINT, named):
        for quantity, known in QUANTITY_WORDS:
            if known_words & known:
                return quantity if quantity != "position" or not rate else _rate_of(rate)
    return "other"


def is_acceleration(name: str) -> bool:
    """Whether a name is that of a rate of a rate, which is no torque whatever it is beside."""
    rate = _RATE.search(base_of(name).rpartition(".")[2])
    return bool(rate and any(rate.groups()))


def _rate_of(rate: re.Match[str]) -> Quantity:
    """What a rate of positions is: of the second order, none that is used."""
    return "other" if any(rate.groups()) else "velocity"


def may_be_rate(rate: str, position: str) -> bool:
    """Whether a velocity may be that of a position by their letters: `phidot` is none of `theta`."""
    own, other = (words_of(_RATE.sub(" ", last_part(name))) & _LETTERS for name in (rate, position))
    return not own or not other or own == other


def drive_unit(words: frozenset[str]) -> str:
    """What a motor's signal is by its words: `"current"`, `"voltage"`, `"duty"`, or empty for a torque or a force."""
    if words & (_TORQUE | {"force"}) - _EFFORT:
        return ""
    kinds = (("current", CURRENT_WORDS), ("voltage", _VOLTAGE), ("duty", _DUTY))
    return next((kind for kind, known in kinds if words & known), "current" if words >= _OUTPUT else "")


def is_straight(words: frozenset[str]) -> bool:
    """Whether words of a position are those of what moves straight, a cart's `x` too."""
    said = words & _STRAIGHT
    of_a_joint = said == {"displacement"} and "joint" in words  # of a joint of any kind
    turns = of_a_joint or bool(words & {"angle", "ang", "angular", "theta", "winkel"})
    return words == {"x"} or bool(said and not turns)


def is_time(name: str) -> bool:
    """Whether a name may be that of times; whether they grow is another matter."""
    words = [token.lower() for token in _TOKEN.findall(english(last_part(unit_apart(name)[0])))]
    while len(words) > 1 and words[-1] in {*_TIME_UNIT, "meas", "measured", "recorded"} - _TIME:
        words.pop()
    return (bool(words) and (words[-1] in _TIME or "timestamp" in words)) or name.endswith("@time")


def time_unit(name: str) -> str:
    """Unit of times that their name tells; empty where it does not."""
    words = [token.lower() for token in _TOKEN.findall(last_part(unit_apart(name)[0]))]
    return _TIME_UNIT.get(words[-1], "") if words and (len(words) > 1 or len(words[0]) > 2) else ""
