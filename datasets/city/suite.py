"""The fixed suites: scenes under conditions with seeds chosen beforehand, and scenes for training."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from fbench.datasets.city.rig import CameraSpec, RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, WorldName, condition

Split: TypeAlias = Literal["dev", "test"]
SEEDS: Mapping[Split, tuple[int, ...]] = {
    "dev": (101, 102, 103, 104, 105, 106, 107, 108),
    "test": (9001, 9002, 9003, 9004),
}
"""Seeds to develop, train and tune on, and those to report figures of. No pipeline may be tuned on the test seeds; they
never change.
"""


DEMO_SEEDS: Mapping[WorldName, tuple[int, ...]] = {"urban": (202, 212), "highway": (205,)}
"""Of the short version: those of 201 to 212 whose first 1.5 s show the most vehicles nearer than 50 m. Nothing was
trained or tuned on any of them.
"""


@dataclass(frozen=True)
class Scene:
    """One entry of the suite."""

    world: WorldName
    condition: str

    def name(self, seed: int) -> str:
        """Name of its log."""
        return f"{self.world}-{self.condition}-{seed}"


SUITE: tuple[Scene, ...] = (
    Scene("urban", "clear"),
    Scene("urban", "traffic"),
    Scene("urban", "rain"),
    Scene("urban", "fog"),
    Scene("urban", "night"),
    Scene("highway", "clear"),
    Scene("highway", "traffic"),
    Scene("highway", "rain"),
    Scene("highway", "fog"),
    Scene("highway", "night"),
    Scene("urban", "traffic+fog"),
    Scene("highway", "heavy-rain"),
)
"""One seed gives the same world in all of them, and the same trajectories wherever traffic is as dense: conditions are
compared on the same scene.
"""


EXPERIMENT: tuple[Scene, ...] = (*SUITE, Scene("urban", "dense-fog"), Scene("highway", "dense-fog"))
"""The suite, and fog that hides what is scored: at the suite's 100 m of visibility a camera that knows fog sees most of
what is nearer than 50 m.
"""
_SHORT = ("clear", "traffic", "rain", "dense-fog", "night")
DEMO: tuple[tuple[Scene, int], ...] = tuple(
    (Scene(world, name), seed) for world, seeds in DEMO_SEEDS.items() for seed in seeds for name in _SHORT
)
"""The short version: two urban scenes and one on the highway, with their seeds, in the thesis's conditions."""


def experiment_spec(scene: Scene, seed: int, seconds: float) -> CitySpec:
    """Return one log of the suite as an experiment: mono camera, LiDAR and radar of the thesis's rig."""
    rig = thesis_rig()
    mono = RigSpec(cameras={"camera": rig.cameras["camera"]}, lidars=rig.lidars, radars=rig.radars,
                   pose_rate_hz=rig.pose_rate_hz)  # fmt: skip
    return CitySpec(scene.world, condition(scene.condition), seconds, seed, mono)


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
