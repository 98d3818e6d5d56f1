"""Frames of logs, for benchmarks that run pipelines in this process."""

from collections.abc import Sequence
from pathlib import Path

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.wish import CityWish
from fbench.replay.clock import VirtualClock
from fbench.replay.config.source import LogWish, log_source
from fbench.replay.data import Frame, LogInfo, Rig
from fbench.replay.excerpt import Excerpt
from fbench.replay.faults import FaultLog
from fbench.replay.frames import FrameStream
from fbench.replay.imports.run import write_recording
from fbench.replay.logs.convert.target import Target
from fbench.replay.restamp import StampParams
from fbench.replay.sync import SyncParams

SENSORS = ("camera", "lidar", "radar")


def frames_of(log: Path) -> tuple[Rig, LogInfo, list[Frame]]:
    """Return rig, description and all frames of a log, held in memory."""
    faults = FaultLog()
    reader = log_source(LogWish(log)).open(faults)
    stream = FrameStream(reader, SyncParams(), StampParams(), Excerpt(), VirtualClock(), faults)
    return stream.rig, reader.info, list(stream.frames(reader))


def write_drive(out: Path, world: str, seconds: float, seed: int, sensors: Sequence[str] = SENSORS) -> Path:
    """Simulate a drive on a clear day with these sensors of the thesis's rig, unless it is there."""
    if not out.exists():
        spec = CityWish(world, seconds=seconds, seed=seed, sensors=sensors).spec()
        write_recording(CityRecording(spec, out.stem), Target(out), lambda name, done, total: None)
    return out
