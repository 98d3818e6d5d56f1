"""What the built-in camera detector learns from: many scenes of their own, in all weathers, seen to all sides."""

from collections.abc import Iterator

from fbench.datasets.city.conditions import condition
from fbench.datasets.city.rig import CameraSpec, RigSpec
from fbench.datasets.city.spec import CitySpec, WorldName

_WORLDS: tuple[WorldName, ...] = ("urban", "highway")
TRAINING_SEEDS = range(301, 371)
"""None of the suite's. Each is another drive: those teach more than other weathers do."""
_WEATHERS = (
    "clear", "fog", "night", "rain", "low-sun", "dusk", "dense-fog", "heavy-rain", "overcast", "night",
)  # fmt: skip
"""One a drive, in turn; by night twice as many, as that is hardest."""
_SECONDS, _RATE_HZ = 30.0, 0.2
"""Few images of a long drive teach more than many of a short one."""
_FRONT_M, _REAR_M = (2.0, 0.0, 1.0), (-2.0, 0.0, 1.2)
_LEFT_M, _RIGHT_M = (0.5, 0.8, 1.4), (0.5, -0.8, 1.6)


def training_logs() -> Iterator[tuple[str, CitySpec]]:
    """Yield name and spec of every log."""
    for world in _WORLDS:
        for place, seed in enumerate(TRAINING_SEEDS):
            turn, weather = divmod(place, len(_WEATHERS))
            name = _crowded(_WEATHERS[weather]) if turn % 2 else _WEATHERS[weather]
            yield f"{world}-{name}-{seed}", CitySpec(world, condition(name), _SECONDS, seed, _rig())


def _crowded(weather: str) -> str:
    """Return the condition that has dense traffic besides."""
    return "traffic" if weather == "clear" else f"traffic+{weather}"


def _rig() -> RigSpec:
    """Four cameras as the thesis's mono camera is, looking ahead, back and to the sides."""
    cameras = {
        "front": _camera(_FRONT_M, 0.0),
        "rear": _camera(_REAR_M, 180.0),
        "left": _camera(_LEFT_M, 60.0),
        "right": _camera(_RIGHT_M, -60.0),
    }
    return RigSpec(cameras=cameras, pose_rate_hz=1.0)


def _camera(translation_m: tuple[float, float, float], yaw_deg: float) -> CameraSpec:
    return CameraSpec(translation_m=translation_m, yaw_pitch_roll_deg=(yaw_deg, 0.0, 0.0), rate_hz=_RATE_HZ)
