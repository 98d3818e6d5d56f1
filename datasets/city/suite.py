"""The fixed suite: scenes under conditions, with seeds that were chosen before anything was tuned on them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from fbench.datasets.city.conditions import condition
from fbench.datasets.city.rig import thesis_rig
from fbench.datasets.city.rig_file import with_value
from fbench.datasets.city.spec import CitySpec, WorldName

Split: TypeAlias = Literal["dev", "test"]
SEEDS: Mapping[Split, tuple[int, ...]] = {
    "dev": (101, 102, 103, 104, 105, 106, 107, 108),
    "test": (9001, 9002, 9003, 9004),
}
"""Seeds to develop, train and tune on, and those to report figures of. No pipeline may be tuned on the test seeds; they
never change.
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


def demo_spec() -> CitySpec:
    """Return what `fbench demo` simulates: a short drive of a development seed, all sensors of the thesis's rig; a few
    radar scans are lost.
    """
    rig = with_value(thesis_rig(), "radar.loss=0.05")
    return CitySpec("urban", condition("clear"), seconds=5.0, seed=SEEDS["dev"][2], rig=rig)
