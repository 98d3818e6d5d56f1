"""Settings of a log given by the user: topics, frames, stamps and clocks."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar, get_args

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.data.messages import Message, Tick
from fbench.replay.data.rig import Kind

if TYPE_CHECKING:  # decoders take a while to import, which readers of boxes needn't
    from fbench.replay.logs.codecs.plugin import NamedDecoder
    from fbench.replay.logs.rig_patch import RigPatch

M = TypeVar("M", bound=Message | Tick)
Doppler = Literal["receding", "approaching"]
EgoMotion = Literal["included", "removed"]


@dataclass(frozen=True)
class SensorSetup:
    """One sensor of a log."""

    topic: str
    kind: Kind
    frame: str = ""  # Its coordinate frame; empty: as its messages say
    calibration: str = ""  # Topic with the intrinsics of a camera; empty: as names and coordinate frames tell
    doppler: Doppler = "receding"  # When recorded radial velocities are positive
    ego_motion: EgoMotion = "included"  # Whether recorded radial velocities hold the vehicle's own motion
    velocity_period_mps: float | None = None
    """Radial velocities alias with this period [m/s]; 0: unambiguous; `None`: as the log says."""
    optional: bool = False  # Whether a log may lack the topic


@dataclass(frozen=True)
class BoxSource:
    """A file or folder with boxes: ground truth, or results of another system."""

    path: Path
    format: str | None = None  # One of `formats.open.FORMATS`; `None`: as its names and content tell
    frame: str = ""  # Coordinate frame of 3D boxes: `body`, `world`, that of a sensor; empty: as file or format say
    camera: str = ""  # Camera of 2D boxes; empty: as the file says, else the only one


def _make_patch() -> "RigPatch":
    from fbench.replay.logs.rig_patch import RigPatch

    return RigPatch()


@dataclass(frozen=True, eq=False)
class Setup:
    """Which topics are which sensors, and what else the log doesn't say."""

    sensors: Mapping[str, SensorSetup] = field(default_factory=dict)
    """By name: these and no others; empty: as the log says."""
    body: str = ""  # Coordinate frame of the body; empty: as its name tells
    pose: str = ""  # Topic with the poses of the body; empty: as the log says
    world: str = ""  # Coordinate frame in which poses from transforms are wanted; empty: the one above all others
    outline_m: tuple[float, float, float] | None = None
    """How far the vehicle reaches from the body's origin to front, rear and side [m]; `None`: as the log says."""
    rig: "RigPatch" = field(default_factory=_make_patch)
    truth_topics: tuple[str, ...] | None = None  # Topics of ground truth; `None`: as their names tell
    result_topics: tuple[str, ...] = ()  # Topics of another system's results
    truth: BoxSource | None = None  # Ground truth instead of that of the log
    results: BoxSource | None = None
    classes: Mapping[str, str] = field(default_factory=dict)
    """Label of fbench, or `ignore`, for the name that a source gives to a class."""
    decoders: "tuple[NamedDecoder, ...]" = ()  # Of messages that fbench doesn't know; the first one that fits counts
    source: str = ""  # Where this was read, for errors


MAX_SKEW_NS = 60_000_000_000  # Clocks that differ by more can't be one clock with a delay [ns]
MAX_OFFSET_MS = 4e12  # Over a hundred years: what is added to a stamp of today still fits 64 bits

StampSource = Literal["header", "log"]


@dataclass(frozen=True)
class StampParams:
    """How the stamps of frames are made from those that were recorded."""

    source: StampSource = "header"  # `header`: when the sensor says it measured; `log`: when the message was recorded
    offsets_ns: Mapping[str, int] = field(default_factory=dict)  # Added to the stamps of one sensor, by its name [ns]
    assumed: tuple[str, ...] = ()  # Sensors whose offset a configuration gives, which may be left out

    def restamp(self, message: M) -> M:
        """Return the message, or an instant of its sensor, with the stamp that counts."""
        stamp = message.log_ns if self.source == "log" else message.stamp_ns
        stamp += self.offsets_ns.get(message.sensor, 0)
        return message if stamp == message.stamp_ns else replace(message, stamp_ns=stamp)

    def require_known(self, sensors: Collection[str]) -> None:
        """Refuse offsets of sensors that aren't there. Raises ConfigError naming the nearest one."""
        for name in sorted(self.offsets_ns):
            if name not in sensors and name not in self.assumed:
                raise ConfigError(f"--offset {name}: no such sensor{did_you_mean(name, sensors)}")


def make_stamp_params(source: str, offsets: Sequence[str]) -> StampParams:
    """Read `--stamps` and `--offset SENSOR=MS`. Raises ConfigError where one is malformed or given twice."""
    if source not in get_args(StampSource):
        raise ConfigError(f"--stamps {source}: expected 'header' or 'log'")
    given: dict[str, int] = {}
    for text in offsets:
        name, _, value = text.rpartition("=")
        if name in given:
            raise ConfigError(f"--offset {text}: '{name}' has an offset already")
        try:
            offset_ms = float(value)
        except ValueError:
            offset_ms = float("nan")
        if not name or not abs(offset_ms) <= MAX_OFFSET_MS:
            raise ConfigError(f"--offset {text}: expected SENSOR=MILLISECONDS, such as radar=-12.5")
        given[name] = round(offset_ms * 1e6)
    return StampParams("log" if source == "log" else "header", dict(sorted(given.items())))


class ClockCheck:
    """Compares the clocks of sensors with that of `reference` where each speaks first: the skew between its stamp and
    the time of recording. Sensors with an offset are trusted.
    """

    def __init__(self, reference: str, params: StampParams) -> None:
        self._reference, self._trusted = reference, params.offsets_ns
        self._skews_ns: dict[str, int] = {}

    def check(self, message: Message | Tick) -> None:
        """Take a restamped message, or the instant at which it was recorded where conditions change its times: those
        may set clocks wrong. Raises LogError where its clock, or one heard before the reference, is another.
        """
        skews_ns, reference = self._skews_ns, self._reference
        if message.sensor in skews_ns:
            return
        skews_ns[message.sensor] = message.stamp_ns - message.log_ns
        if reference not in skews_ns:
            return
        for name in sorted(skews_ns) if message.sensor == reference else (message.sensor,):
            difference_ns = skews_ns[name] - skews_ns[reference]
            if name not in self._trusted and abs(difference_ns) > MAX_SKEW_NS:
                what = f"its clock differs from that of '{reference}' by {difference_ns / 1e9:.3f} s"
                advice = mending_offset(name, skews_ns[name], reference, skews_ns[reference])
                raise LogError(f"sensor '{name}': {what}; give {advice} or --stamps log", "TIM008")


def mending_offset(name: str, skew_ns: int, reference: str, reference_skew_ns: int) -> str:
    """Return the option that makes the clocks of a sensor and the reference one: it moves the sensor whose stamps are
    farther from the times of recording; skews are stamp minus time of recording.
    """
    difference_ns = skew_ns - reference_skew_ns
    if abs(reference_skew_ns) > abs(skew_ns):
        return f"--offset {reference}={difference_ns / 1e6:.0f}"
    return f"--offset {name}={-difference_ns / 1e6:.0f}"
