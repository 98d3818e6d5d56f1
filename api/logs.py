"""Logs: open one to read its messages and frames, and simulate one."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import make_excerpt
from fbench.replay.engine.frames import FrameStream
from fbench.replay.logs.reader import LogReader
from fbench.replay.setup.source import LogRequest, LogSource, log_source

if TYPE_CHECKING:
    from fbench.datasets.city.request import CityRequest


@dataclass(frozen=True, eq=False)
class OpenLog:
    """A log that can be read from its beginning, repeatedly."""

    source: LogSource
    reader: LogReader
    faults: FaultLog
    """Counts what is wrong with the log while it is read."""

    @property
    def info(self) -> LogInfo:
        """What the log says about itself."""
        return self.reader.info

    @property
    def rig(self) -> Rig:
        """The sensors with their calibration at the beginning of the log."""
        return self.reader.rig

    def messages(self) -> Iterator[Message | RigChange]:
        """Yield all messages in the order of `log_ns`, with changes of the calibration between them."""
        return self.reader.messages()

    def truths(self) -> Iterator[Truth]:
        """Yield the ground truth of each instant, in the order of stamps."""
        return self.reader.truths()

    def frames(
        self,
        frames: str | None = None,
        reference: str | None = None,
        timeout_ms: float | None = None,
        tolerance_ms: float | None = None,
        max_gap_s: float | None = None,
        offset: Sequence[str] = (),
        stamps: str | None = None,
    ) -> Iterator[Frame]:
        """Yield frames as a replay assembles them; the options are those of `ReplayRequest`. Raises ConfigError where
        an option isn't as expected. Raises LogError where the log has no message of any sensor with calibration.
        """
        sync = self.source.sync_params(reference, timeout_ms, tolerance_ms, max_gap_s)
        params = sync, self.source.stamps(stamps, offset), make_excerpt(None, None, frames)
        return FrameStream(self.reader, *params, Clock(), self.faults).frames(self.reader)

    def _repr_html_(self) -> str:
        """Show the log's name and sensors in a notebook."""
        counts, estimated = self.reader.num_messages, self.reader.estimated
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{mount.kind}</td>"
            f"<td>{'≈' if name in estimated else ''}{counts.get(name, 0)}</td></tr>"
            for name, mount in sorted(self.rig.mounts.items())
        )
        head = "<tr><th>sensor</th><th>kind</th><th>messages</th></tr>"
        return f"<p><b>{escape(self.info.name)}</b> ({escape(self.info.log_id)})</p><table>{head}{rows}</table>"


@dataclass(frozen=True)
class SimulateRequest:
    """One simulated log."""

    city: "CityRequest"
    """What to simulate."""
    out: Path
    """`FILE.mcap` or `FOLDER.parquet`."""
    overwrite: bool = False
    threads: int | None = None
    """How many to use; `None`: as many as there are cores. No byte depends on it."""


def open_log(log: LogRequest | Path | str) -> OpenLog:
    """Open a log, whatever its container and encoding.

    Args:
        log: Its path, or a request that also says what goes with it.

    Raises:
        ConfigError: where a file beside the log can't be used.
        LogError: where it isn't a log, or has no rig.
    """
    source = log_source(log if isinstance(log, LogRequest) else LogRequest(Path(log)))
    faults = FaultLog()
    return OpenLog(source, source.open(faults), faults)


def simulate(
    request: SimulateRequest, progress: Callable[[str, int, int], None] = lambda name, done, total: None
) -> Path:
    """Simulate a log of the city and return its path; the same request gives the same bytes.

    Args:
        request: What to simulate, and where the log goes.
        progress: Gets the name of the log and how many of its items are done.

    Raises:
        ConfigError: where something requested isn't there, or the log can't be written.
    """
    from fbench.datasets.city.recording import CityRecording
    from fbench.datasets.importing.run import write_recording
    from fbench.replay.logs.convert.target import Target

    recording = CityRecording(request.city.spec(), request.out.stem, request.threads)
    write_recording(recording, Target(request.out, request.overwrite), progress)
    return request.out
