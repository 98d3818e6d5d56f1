"""Protocols that plug-ins implement. Built-ins come in by the same entry-point groups."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

from fbench.replay.contracts.importing import Imported, ImportRequest
from fbench.replay.data.frames import Fault, Frame, Output
from fbench.replay.data.messages import Message, Pose, Tick, Truth
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.data.scores import Score, ScoreOptions

if TYPE_CHECKING:  # reading of runs takes half a second to import, which programs of plug-ins needn't
    from fbench.replay.runs.folder import Run


class Reader(Protocol):
    """One log, read as a stream; never loads a whole log."""

    @property
    def info(self) -> LogInfo:
        """Name, id and metadata."""

    @property
    def rig(self) -> Rig:
        """Sensors and their calibration, as the log begins."""

    @property
    def num_messages(self) -> Mapping[str, int]:
        """Messages of each sensor and stream of poses, by name; without any of sensors, those with boxes as `BOXES`."""

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the streams of poses, which frames wait for like for sensors."""

    def messages(self) -> Iterator[Message | RigChange | Tick]:
        """All measurements in canonical order: (`log_ns`, topic, position in the topic's stream). Between them come the
        changes of the rig, and where conditions change the times of a sensor, its instants as they were recorded.
        """

    def events(self) -> Iterator[Message | RigChange | Tick]:
        """The same with the instants of boxes between them, for logs without measurements: those of truth, else those
        of results.
        """

    def truths(self) -> Iterator[Truth]:
        """Ground truth in the order of its stamps."""


class ReaderWrapper:
    """A log whose messages pass through `pass_on`, which gives them as they are; all else is as with the reader."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    @property
    def info(self) -> LogInfo:
        """Name, id and metadata."""
        return self._reader.info

    @property
    def rig(self) -> Rig:
        """Sensors as the log begins."""
        return self._reader.rig

    @property
    def num_messages(self) -> Mapping[str, int]:
        """As recorded."""
        return self._reader.num_messages

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the streams of poses."""
        return self._reader.poses

    def truths(self) -> Iterator[Truth]:
        """Ground truth."""
        return self._reader.truths()

    def messages(self) -> Iterator[Message | RigChange | Tick]:
        """All messages, passed on."""
        return self.pass_on(self._reader.messages())

    def events(self) -> Iterator[Message | RigChange | Tick]:
        """The same with the instants of boxes."""
        return self.pass_on(self._reader.events())

    def pass_on(self, messages: Iterator[Message | RigChange | Tick]) -> Iterator[Message | RigChange | Tick]:
        """Yield what becomes of messages."""
        return messages


class Recording(Protocol):
    """One sequence of a dataset, which becomes one log."""

    @property
    def name(self) -> str:
        """As the dataset calls it; also the name of its log in a folder of logs."""

    @property
    def info(self) -> LogInfo:
        """The log's name, its id, its id (see `contracts.importing.log_id`) and the dataset's facts.
        Raises LogError naming the file that is missing or wrong.
        """

    @property
    def rig(self) -> Rig:
        """Sensors and calibration, as the log begins. Raises LogError naming the file that is missing or wrong."""

    @property
    def num_items(self) -> int:
        """About how many items there are, for the progress bar."""

    def items(self) -> Iterator[Imported]:
        """What the log is to hold, in the order of `log_ns`; reads files as it goes, each once. Raises LogError naming
        the file that can't be used, unless such are skipped.
        """

    def summary(self) -> Sequence[str]:
        """Lines that say what was found and what was odd; asked when all items were read."""


class Importer(Protocol):
    """Turns one public dataset into fbench logs.

    Made without arguments, or with `params` as a pipeline is: their fields are what `--set` changes.
    """

    def names(self, source: Path) -> Sequence[str]:
        """Names of the sequences in the folder `source`, found without reading them. Raises LogError where it isn't a
        folder of the dataset, or lacks what all sequences need.
        """

    def recordings(self, source: Path, request: ImportRequest) -> Iterator[Recording]:
        """Open the sequences that are asked for, one after the other; each is done with when the next one comes. Raises
        LogError naming the file that is missing or wrong.
        """


class Pipeline(Protocol):
    """Frames in, detections and tracks out.

    Made without arguments, or with one argument `params`, annotated with a frozen dataclass whose fields all
    have defaults; these are what `--set name.field=value` changes.
    """

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Prepare for one log; called again where the rig changes within it, before `reset`. Raises LogError where the
        rig lacks a sensor that the pipeline can't do without.
        """

    def reset(self, reason: str) -> None:
        """Forget all tracks: a segment of the log begins."""

    def step(self, frame: Frame) -> Output:
        """Process one frame. Must depend on nothing but the frames since the last reset."""


class BoxReader(Protocol):
    """What a log, or a file beside it, holds of another system's results."""

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the streams of poses, which alone can move boxes from the world to the body."""

    def body_poses(self) -> Iterator[Pose]:
        """Poses of all streams, in the order in which they were recorded."""

    def detections(self, topic: str) -> Iterator[Truth]:
        """Boxes of one topic in the order in which they were recorded; where `topic` is empty, those of the file that
        was named beside the log, in the order of their stamps. `log_ns` is when they were recorded. Raises LogError
        where there is no such topic, naming the nearest ones.
        """


@runtime_checkable
class UsesLog(Protocol):
    """A pipeline that needs more of the log than its frames."""

    def use_log(self, log: BoxReader) -> None:
        """Take the log, before `start`."""


@runtime_checkable
class Closes(Protocol):
    """A pipeline that holds something which must be given back: a process, say."""

    def close(self) -> None:
        """Give it back; called once, at the end, also after an error."""


@runtime_checkable
class TakesArgument(Protocol):
    """A pipeline's class with a parameter that may follow its name: `exec:./my_stack`."""

    argument: ClassVar[str]
    """Name of that parameter."""


@runtime_checkable
class UsesSensors(Protocol):
    """A pipeline that says which sensors it uses, so that conditions on others cost nothing: it may get their messages
    as they were recorded.
    """

    def used_sensors(self) -> Collection[str]:
        """Names of all sensors at whose images or points it looks; asked after `start`."""


@runtime_checkable
class SkipsFrames(Protocol):
    """A pipeline that wants to know of the frames that it doesn't get, since they came while it worked."""

    def skip(self, frame: Frame) -> None:
        """Take note of a frame that was dropped; frames and dropped ones come in their order."""


@runtime_checkable
class Overlaps(Protocol):
    """A pipeline of which the larger part of the work on a frame needs nothing of earlier frames but their poses, so
    that several frames can be worked on at the same time (`--overlap`), each in another process.

    `step` must be `conclude(frame, observe(frame))`. In each process every frame comes once, in order: to `observe`, or
    to `pass_by` where another process observes it. The replay's own process concludes all frames, in order.
    """

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """As that of `Pipeline`."""

    def reset(self, reason: str) -> None:
        """As that of `Pipeline`; in other processes than the replay's own also where the first segment begins."""

    def observe(self, frame: Frame) -> object:
        """Do what needs nothing of earlier frames; what it returns must be what `pickle` can send."""

    def pass_by(self, frame: Frame) -> None:
        """Take note of a frame that another process observes; it may hold poses only."""

    def conclude(self, frame: Frame, observed: Any) -> Output:
        """Do the rest, which may depend on what was concluded since the last reset."""


@runtime_checkable
class NeedsSensors(Protocol):
    """A pipeline that says which sensors its results rest on: where hardly any frame has one of them, data was lost."""

    def required_sensors(self) -> Collection[str] | None:
        """Names of sensors of the rig that it was started with; asked when it has been started. `None`: it doesn't say,
        as if there were no such method.
        """


@runtime_checkable
class Tracks(Protocol):
    """A pipeline that says whether it tracks. Of another one the outputs tell: see `Output.tracks`."""

    @property
    def is_tracker(self) -> bool | None:
        """Whether it tracks, also where it has followed nothing. `None`: the outputs tell."""


@runtime_checkable
class GivesWarnings(Protocol):
    """A pipeline that can say what casts doubt on all of its results."""

    def warnings(self) -> Sequence[Fault]:
        """Warnings with codes of the fault table that only flag; asked once, when all frames were run."""


@runtime_checkable
class TellsIdentity(Protocol):
    """A pipeline whose work is done by something that its parameters don't tell apart: one build of a program, say."""

    def identity(self) -> Mapping[str, object]:
        """What tells it apart, by names for the manifest's parameters, JSON-ready; asked at the end of a run. Names of
        files stand under the key `file`, so that `--redact` finds them.
        """


@runtime_checkable
class KeepsStderr(Protocol):
    """A pipeline whose work is done by a program that talks."""

    def stderr(self) -> bytes:
        """What it wrote to stderr until now, bounded; may be any bytes."""


@runtime_checkable
class TellsCpuTime(Protocol):
    """A pipeline that works in another process."""

    def cpu_ns(self) -> int | None:
        """CPU time [ns] that the program that runs has used; `None`: unknown, or none runs."""


class Metric(Protocol):
    """Scores of one run, computed from its folder alone. Made without arguments."""

    def scores(self, run: "Run", options: ScoreOptions) -> Sequence[Score]:
        """Return this metric's rows, the primary one first."""


@runtime_checkable
class AddsCounts(Protocol):
    """A metric of which runs can be scored together: the counts of its rows say all, also added over runs."""

    def value_of(self, metric: str, counts: Mapping[str, int | float]) -> float | None:
        """Return the value of a row of this name from its counts, added over runs; `None` where it is undefined."""


class Report(Protocol):
    """Turns runs and their scores into a file; computes nothing. Made without arguments."""

    def write(self, runs: "Sequence[Run]", out: Path) -> None:
        """Write the report of these runs to `out`."""
