"""The fixed suite: scenes under conditions, with seeds that were chosen before anything was tuned on them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from fbench.datasets.city.conditions import condition
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, WorldName

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
