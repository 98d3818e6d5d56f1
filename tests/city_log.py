"""Small logs of the simulated city for tests that need some log: a LiDAR and a radar of few rays, and small cameras."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.kept_cities import kept

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import CameraSpec, LidarSpec, RadarSpec, RigSpec
from fbench.datasets.city.spec import CitySpec, WorldName
from fbench.datasets.importing.run import write_recording
from fbench.replay.logs.convert.target import Target

SMALL_RIG = RigSpec(
    lidars={
        "lidar": LidarSpec(
            translation_m=(1.2, 0.0, 1.9), rate_hz=10.0, channels=32, points_per_s=230_400, range_m=80.0,
            upper_deg=4.0, lower_deg=-25.0,
        )
    },
    radars={
        "radar": RadarSpec(
            translation_m=(2.2, 0.0, 0.8), phase_ms=7.0, points_per_s=40_000, range_m=80.0, vertical_fov_deg=12.0,
            loss=0.03,
        )
    },
    pose_rate_hz=10.0,
)  # fmt: skip


_CAMERAS = {
    name: CameraSpec(translation_m=(2.0, y, 1.0), rate_hz=10.0, size_wh=(320, 240))
    for name, y in (("camera", 0.0), ("stereo_left", 0.2), ("stereo_right", -0.2))
}


def write_city_log(
    out: Path, seconds: float = 3.0, seed: int = 0, world: WorldName = "urban", cameras: bool = False
) -> None:
    """Write a log of a clear day; each is simulated once a process. `cameras`: one, and a pair, which take longer."""
    out.write_bytes(_content(seconds, seed, world, cameras))


@cache
def _content(seconds: float, seed: int, world: WorldName, cameras: bool) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "city.mcap"
        rig = SMALL_RIG.model_copy(update={"cameras": _CAMERAS}) if cameras else SMALL_RIG
        spec = CitySpec(world, seconds=seconds, seed=seed, rig=rig)
        write_recording(CityRecording(spec, "city", cities=kept()), Target(path), lambda name, done, total: None)
        return path.read_bytes()
