"""Logs of the simulated city for benchmarks."""

from pathlib import Path

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.request import CityRequest
from fbench.datasets.importing.run import write_recording
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.messages import Image, Truth
from fbench.replay.logs.convert.target import Target


def write_city_log(out: Path, seconds: float) -> None:
    """Simulate an urban drive on a clear day, with LiDAR and radar of the thesis's rig."""
    spec = CityRequest("urban", seconds=seconds, seed=101, sensors=["lidar", "radar"]).spec()
    write_recording(CityRecording(spec, out.stem), Target(out), lambda name, done, total: None)


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
