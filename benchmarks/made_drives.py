"""Logs of the simulated city and frames of logs, for benchmarks."""

from collections.abc import Sequence
from pathlib import Path

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.request import CityRequest
from fbench.datasets.importing.run import write_recording
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, Truth
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.engine.clock import VirtualClock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.frames import FrameStream
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.setup import StampParams
from fbench.replay.setup.source import LogRequest, log_source

SENSORS = ("camera", "lidar", "radar")


def frames_of(log: Path) -> tuple[Rig, LogInfo, list[Frame]]:
    """Return rig, description and all frames of a log, held in memory."""
    faults = FaultLog()
    reader = log_source(LogRequest(log)).open(faults)
    stream = FrameStream(reader, SyncParams(), StampParams(), Excerpt(), VirtualClock(), faults)
    return stream.rig, reader.info, list(stream.frames(reader))


def write_drive(out: Path, world: str, seconds: float, seed: int, sensors: Sequence[str] = SENSORS) -> Path:
    """Simulate a drive on a clear day with these sensors of the thesis's rig, unless it is there."""
    if not out.exists():
        spec = CityRequest(world, seconds=seconds, seed=seed, sensors=sensors).spec()
        write_recording(CityRecording(spec, out.stem), Target(out), lambda name, done, total: None)
    return out


def write_city_log(out: Path, seconds: float) -> None:
    """Simulate an urban drive on a clear day, with LiDAR and radar of the thesis's rig."""
    write_drive(out, "urban", seconds, 101, ["lidar", "radar"])


def images_and_truth(log: CityRecording) -> tuple[dict[int, Image], dict[int, Boxes2D]]:
    """Return the images of a drive with one camera, and what is true of them, by stamp."""
    images: dict[int, Image] = {}
    truth: dict[int, Boxes2D] = {}
    for item in log.items():
        if isinstance(item, Image):
            images[item.stamp_ns] = item
        elif isinstance(item, Truth) and item.boxes2d is not None:
            truth[item.stamp_ns] = item.boxes2d
    return images, truth
