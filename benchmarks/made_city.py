"""A log of the simulated city for benchmarks: LiDAR and radar of the thesis's rig."""

from pathlib import Path

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.wish import CityWish
from fbench.replay.imports.run import write_recording
from fbench.replay.logs.convert.target import Target


def write_city_log(out: Path, seconds: float) -> None:
    """Simulate an urban drive on a clear day."""
    spec = CityWish("urban", seconds=seconds, seed=101, sensors=["lidar", "radar"]).spec()
    write_recording(CityRecording(spec, out.stem), Target(out), lambda name, done, total: None)
