"""Options of slave, master and the other verbs for command line, files and API: meaning, unit and range."""

import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias, TypeVar, get_args

from hapticnet.checks import check_integer, check_parameter
from hapticnet.errors import SettingsError
from hapticnet.files import MAX_BYTES, parse_bytes

Owner = TypeVar("Owner")
MAX_SIZE: Final = MAX_BYTES
RECORD_LIMIT: Final = 2 * 2**30
INSERTIONS: Final = 5
POSITION_SHARE: Final = 0.25
VIBRATION_BUDGET: Final = 6000.0
AUTO: Final = "auto"  # address of the page where none is written


@dataclass(frozen=True, slots=True)
class Option:
    """The description of an option for every interface."""

    help: str  # what it does, for the help of the command line and for the API's page
    metavar: str | None = None  # the name of its value in the help
    flags: tuple[str, ...] = ()  # its names on the command line, unless they follow from the parameter's
    variable: str | None = None  # the environment variable that all verbs share
    least: float | None = None
    most: float | None = None
    unit: str = ""  # of its values
    parser: Callable[[Any], Any] | None = None  # parser of its text
    show_default: bool = True  # whether the help prints the default
    argument: bool = False  # whether it has no name on the command line, only a place

    def check(self, name: str, value: Any) -> None:
        """Raise SettingsError if the value is out of range; `name` is the user's name for the setting."""
        if value is None or self.least is None or self.most is None:
            return
        if isinstance(self.least, int) and isinstance(self.most, int):
            check_integer(name, value, self.least, self.most, self.unit)
        else:
            check_parameter(name, value, self.least, self.most, self.unit)


def option_of(annotation: Any) -> Option | None:
    """Return the setting that an annotation declares, if it does."""
    return next((each for each in getattr(annotation, "__metadata__", ()) if isinstance(each, Option)), None)


def check_options(owner: Any) -> None:
    """Raise SettingsError if a field of a dataclass that declares a setting is out of range, or none of the choices."""
    for name, field in owner.__dataclass_fields__.items():
        if (option := option_of(field.type)) is None:
            continue
        value = getattr(owner, name)
        kind = field.type.__origin__
        if getattr(kind, "__origin__", None) is Literal and value not in get_args(kind):
            raise SettingsError(f"{name} is {value!r}; choose from {', '.join(get_args(kind))}")
        option.check(name, value)


def described(owner: type[Owner]) -> type[Owner]:
    """Add the meaning of a dataclass's options to its docstring."""
    declared: dict[str, Any] = vars(owner)["__dataclass_fields__"]
    lines = [
        f"{name} : {_text(field.type)}\n    {option.help}"
        for name, field in sorted(declared.items(), key=lambda each: each[0] not in vars(owner)["__annotations__"])
        if (option := option_of(field.type)) is not None
    ]
    owner.__doc__ = "\n".join([inspect.cleandoc(owner.__doc__ or ""), "", "Parameters", "----------", *lines])
    return owner


def _text(annotation: Any) -> str:
    kind = annotation.__origin__
    return kind.__name__ if isinstance(kind, type) else re.sub(r"\b(?:\w+\.)+", "", str(kind))


def _seconds(help: str, least: float, most: float) -> Option:  # noqa: A002 - as that of Option
    return Option(help, "SECONDS", least=least, most=most, unit="s")


def _size(what: str) -> Option:
    text = f"{what}, such as 500MB or 8GiB; default: 2GiB."
    return Option(text, "SIZE", parser=parse_bytes, show_default=False)


Missing: TypeAlias = Literal["refuse", "drop", "hold"]
ExportFormat: TypeAlias = Literal["csv", "mcap", "npz"]
PlotFormat: TypeAlias = Literal["png", "pdf", "svg"]

# Connection and keys.
Connect: TypeAlias = Annotated[str, Option("Where the slave listens.", "HOST:PORT")]
Listen: TypeAlias = Annotated[str, Option("Where to listen; port 0 means a free one.", "HOST:PORT")]
ConnectTimeout: TypeAlias = Annotated[
    float | None, Option("Give up when no slave answers for this long.", "SECONDS", least=0.0)
]
Name: TypeAlias = Annotated[str, Option("Name of this master in the slave's report.")]
FastestRate: TypeAlias = Annotated[float, Option("Highest sample rate granted to a master.", "HZ")]
MostSessions: TypeAlias = Annotated[int, Option("Sessions served at once.", least=1, most=1_000_000)]
MostSessionsPerKey: TypeAlias = Annotated[
    int,
    Option("Sessions of one key at once (without keys, of one host), unless the list does.", least=1, most=1_000_000),
]
Keep: TypeAlias = Annotated[
    float, _seconds("Keep the scene of a silent master this long for its return.", 1.0, 86_400.0)
]
Drain: TypeAlias = Annotated[
    float,
    _seconds("When stopped, take no new masters and let the present ones finish for up to this long.", 0.0, 86_400.0),
]
Key: TypeAlias = Annotated[
    Path | None, Option("This host's key file, made by 'hapticnet key new'.", "FILE", variable="HAPTICNET_KEY")
]
PeerKey: TypeAlias = Annotated[
    str | None,
    Option(
        "The slave's public key, printed by 'hapticnet key public' on its host.",
        "BASE64",
        variable="HAPTICNET_PEER_KEY",
    ),
]
Masters: TypeAlias = Annotated[
    Path | None,
    Option(
        "The masters that are admitted, as [[master]] tables of a TOML file; read again on SIGHUP.",
        "FILE",
        variable="HAPTICNET_MASTERS",
    ),
]
KeyPath: TypeAlias = Annotated[
    str | Path | None, Option("This host's key file; default where one is needed: ~/.config/hapticnet/key.toml.")
]
MastersPath: TypeAlias = Annotated[
    str | Path | None, Option("The file that lists the served masters; default: masters.toml beside the key.")
]
KeyArgument: TypeAlias = Annotated[
    Path | None,
    Option("The key file; default: ~/.config/hapticnet/key.toml.", "FILE", variable="HAPTICNET_KEY", argument=True),
]
Insecure: TypeAlias = Annotated[
    bool, Option("Allow open sessions with other hosts: neither encrypted nor authenticated.")
]

# Operator and device.
Operator: TypeAlias = Annotated[
    str | None,
    Option(
        "Source of positions: scripted (insertions, the default), palpation[:axes=2] (on three or two axes),"
        " hand:NAME[,KEY=VALUE…] (a hand that the force moves: arm, stiff-arm, tired-arm, finger), page (the live page;"
        " the default with --page), trace:FILE[:COLUMN,…] (a recording),"
        " udp:[HOST:]PORT[,axes=N] (another program), or a class of yours with sample(t_us): FILE.py:CLASS or"
        " package.module:CLASS.",
        "OPERATOR",
    ),
]
Scale: TypeAlias = Annotated[
    float, Option("Metres of the tool for a metre of the hand.", "FACTOR", least=0.001, most=1000.0)
]
ForceScale: TypeAlias = Annotated[
    float, Option("Newtons in the hand for a newton of the scene.", "FACTOR", least=0.001, most=1000.0)
]
_FRAME: Final = Option(
    "Rotation of the hand's frame into that of the scene [degrees]: a rotation vector on three axes, an angle on two.",
    "RX,RY,RZ",
)
_OFFSET: Final = Option("Where the tool is when the hand is at 0 [m].", "X[,Y[,Z]]")
Frame: TypeAlias = Annotated[str | None, _FRAME]
FrameNumbers: TypeAlias = Annotated[Sequence[float] | None, _FRAME]
Offset: TypeAlias = Annotated[str | None, _OFFSET]
OffsetNumbers: TypeAlias = Annotated[Sequence[float] | None, _OFFSET]
Insertions: TypeAlias = Annotated[int, Option("Insertions or palpations of the scripted operator.", least=1)]
Rate: TypeAlias = Annotated[float, Option("Positions a second.", "HZ")]
Positions: TypeAlias = Annotated[
    Literal["raw", "line"],
    Option("Which positions to send: every one (raw), or those that matter, with a velocity (line)."),
]
PositionShare: TypeAlias = Annotated[
    float, Option("With --positions line: the share of the JND that positions may use.")
]
Device: TypeAlias = Annotated[
    str,
    Option(
        "Fingertip device: sim[:N/MM], simavr[:N/MM] (the compiled firmware, simulated), serial:auto,"
        " serial:PATH, the NAME of an installed one (hapticnet device new), a class of yours with exchange or apply as"
        " FILE.py:CLASS or package.module:CLASS, or none. N/MM is the simulated finger's stiffness.",
        "DEVICE",
    ),
]
DeviceArgument: TypeAlias = Annotated[
    str, Option("sim[:N/MM], simavr[:N/MM], serial:auto, serial:PATH or FILE.py:CLASS.", "DEVICE", argument=True)
]
DeviceTakes: TypeAlias = Annotated[
    Literal["x", "y", "z", "norm"], Option("The part of a force of several axes that the device renders.")
]
Profile: TypeAlias = Annotated[
    Path | None, Option("The device's calibration and finger, from hapticnet device.", "FILE")
]
Coupling: TypeAlias = Annotated[
    str,
    Option(
        "How to keep a hand that yields from oscillating: direct (not at all), energy-bounded, or one of an installed"
        " package.",
        "NAME[:KEY=VALUE,…]",
    ),
]
MaxAge: TypeAlias = Annotated[
    float, _seconds("Ignore forces that answer a position older than this, by the master's clock.", 0.01, 60.0)
]
FirstTouch: TypeAlias = Annotated[bool, Option("Find the finger with a press of 1 N before asking for a session.")]

# Scene, codec and perception.
Scene: TypeAlias = Annotated[
    str,
    Option(
        "Scene for masters: paper, paper:SEED, a preset, FILE.toml, recording:FILE[:COLUMN,…] (a force in its own"
        " time), udp:[HOST:]PORT[,KEY=VALUE…] (another program), or a class of yours with step(sample): FILE.py:CLASS"
        " or package.module:CLASS, then :KEY=VALUE,… for its arguments.",
        "SCENE",
    ),
]
Announce: TypeAlias = Annotated[
    bool, Option("Tell masters that ask for it what the scene declares of the contact ahead.")
]
Announced: TypeAlias = Annotated[
    bool, Option("Ask the slave to announce the contact ahead, and render it without delay.")
]
Predicted: TypeAlias = Annotated[
    bool,
    Option(
        "Ask the slave to answer for where the hand will be when the force arrives, on a copy of its scene, which makes"
        " up for most of the delay. When the hand turns round, the force comes too early or too late."
    ),
]
Vibration: TypeAlias = Annotated[
    bool, Option("Ask the slave for vibration beside force, and play it on the device or a simulated voice coil.")
]
VibrationBudget: TypeAlias = Annotated[
    float, Option("With --vibration: the most bytes a second that it may take.", "BYTES", least=500.0, most=1e6)
]
Codec: TypeAlias = Annotated[
    str,
    Option(
        "Feedback codec; hapticnet codecs lists them. One of yours: FILE.py:CLASS or package.module:CLASS.",
        "NAME[:KEY=VALUE,…]",
    ),
]
AddCodec: TypeAlias = Annotated[
    list[str] | None,
    Option(
        "Codec of yours that masters may ask for, or package.module:CLASS; repeat for more. Codecs of"
        " installed packages are always served.",
        "FILE.py:CLASS",
    ),
]
Weber: TypeAlias = Annotated[float, Option("Weber fraction k: JND = k·|force|. The paper's mean: 0.05.", "FRACTION")]
Floor: TypeAlias = Annotated[float, Option("Smallest JND; applies where k·|force| is below it.", "NEWTONS")]
Law: TypeAlias = Annotated[
    Path | None, Option("The law that 'experiment limits' measured, instead of --weber and --floor.", "FILE")
]
Multiplier: TypeAlias = Annotated[float, Option("Deadband threshold in JNDs. The paper's: 1, 2, 4.")]

# Emulated network.
ChannelOut: TypeAlias = Annotated[
    str,
    Option(
        "Emulated network for outgoing datagrams: a preset (lan, wifi, 4g, transatlantic, satellite) or parts"
        " such as delay=20ms,jitter=normal:5ms,loss=2%.",
        "SPEC",
    ),
]
ChannelIn: TypeAlias = Annotated[
    str, Option("The same for arriving datagrams; together they emulate both directions.", "SPEC")
]

# Reading of files.
ForceColumn: TypeAlias = Annotated[
    str | None, Option("Force columns [N], by name or number from 0; one to three axes.", "NAME[,NAME…]")
]
TimeColumn: TypeAlias = Annotated[
    str | None, Option("Column of the times, by name or number; default: one called t, time, timestamp …", "NAME")
]
SamplingRate: TypeAlias = Annotated[float | None, Option("Sampling rate of files without a column of times.", "HZ")]
PositionColumn: TypeAlias = Annotated[
    str | None, Option("Position columns [m]; default: those called position or pos.", "NAME[,NAME…]")
]
PositionScale: TypeAlias = Annotated[
    float | None,
    Option(
        "Metres per unit of position, instead of the unit in the column's name; negative if positions increase in"
        " the direction of a positive force.",
        "METRES",
    ),
]
Start: TypeAlias = Annotated[
    str | None,
    Option(
        "Move all positions so that the first is at this place [m], to put a recorded hand into the scene.", "X[,Y[,Z]]"
    ),
]
MissingValues: TypeAlias = Annotated[
    Missing, Option("Empty cells and NaN: refuse the file, drop such rows, or hold (repeat) the last value.")
]
MaxSize: TypeAlias = Annotated[int, _size("Largest file that is read")]

# Recording, monitoring, output and running.
Record: TypeAlias = Annotated[
    Path | None, Option("Record every tick, datagram and event in FILE: .mcap or .csv.", "FILE")
]
RecordDir: TypeAlias = Annotated[
    Path | None, Option("Record each session in DIR/NAME-SESSION and the format's suffix.", "DIR")
]
RecordFormat: TypeAlias = Annotated[Literal["csv", "mcap"], Option("Format of the recordings.")]
RecordLimit: TypeAlias = Annotated[int, _size("Disk space that recordings may take")]
Page: TypeAlias = Annotated[
    str | None,
    Option(
        "Serve the live page, by default on 127.0.0.1:47880 or a free port, and print its URL; needs the extra web.",
        "[HOST:PORT]",
    ),
]
Metrics: TypeAlias = Annotated[
    str | None,
    Option("Serve metrics for Prometheus at /metrics, and the state of this process at /health.", "HOST:PORT"),
]
Json: TypeAlias = Annotated[bool, Option("Print the report as JSON on stdout.")]
Report: TypeAlias = Annotated[Path | None, Option("Write the report to FILE as JSON too.", "FILE")]
Overwrite: TypeAlias = Annotated[bool, Option("Overwrite files that exist.")]
Quiet: TypeAlias = Annotated[bool, Option("Print only errors and the report.", flags=("--quiet/--no-quiet", "-q"))]
Duration: TypeAlias = Annotated[float | None, Option("Stop after this many seconds.", "SECONDS", least=0.0)]
SessionDuration: TypeAlias = Annotated[
    float | None, Option("Stop this long after connecting; otherwise when the operator is done.", "SECONDS", least=0.0)
]
Seed: TypeAlias = Annotated[int, Option("Seed of the random numbers.", least=0)]
Jobs: TypeAlias = Annotated[
    int | None, Option("Processes; default: one for each core. The results do not depend on it.", least=1)
]
RealTime: TypeAlias = Annotated[bool, Option("Use real-time scheduling (SCHED_FIFO) if permitted.")]


@dataclass(kw_only=True)
class SharedMasterOptions:
    """Settings of a master common to command line and API."""

    peer_key: PeerKey = None
    insecure: Insecure = False
    name: Name = "master"
    device_takes: DeviceTakes = "x"
    announced: Announced = False
    predicted: Predicted = False
    vibration: Vibration = False
    vibration_budget: VibrationBudget = VIBRATION_BUDGET
    positions: Positions = "raw"
    position_share: PositionShare = POSITION_SHARE
    scale: Scale = 1.0
    force_scale: ForceScale = 1.0
    first_touch: FirstTouch = False
    coupling: Coupling = "direct"

    def of_node(self) -> dict[str, Any]:
        """Return the settings of the node, by the same names, except keys and the mapping of the hand."""
        others = ("peer_key", "insecure", "scale", "force_scale")
        names = (name for name in SharedMasterOptions.__dataclass_fields__ if name not in others)
        return {name: getattr(self, name) for name in names}


@dataclass(kw_only=True)
class SharedSlaveOptions:
    """Settings of a slave common to command line and API."""

    listen: Listen = "127.0.0.1:47800"
    insecure: Insecure = False
    most_sessions: MostSessions = 64
    most_sessions_per_key: MostSessionsPerKey = 16
    announce: Announce = True
