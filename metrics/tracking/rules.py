"""Which boxes of a sequence count, as benchmarks of tracking in images have it."""

from dataclasses import dataclass, field
from typing import Literal

from fbench.metrics.profile import Match


@dataclass(frozen=True)
class ClassRule:
    """One class that is scored."""

    name: str
    labels: frozenset[str] = frozenset()
    """Labels that belong to it; empty: all."""
    distractors: frozenset[str] = frozenset()
    """Labels of truth that results may take for it: those are neither hits nor false alarms."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", frozenset(self.labels))
        object.__setattr__(self, "distractors", frozenset(self.distractors))


@dataclass(frozen=True)
class Preparation:
    """What is excused and left out before anything is counted."""

    classes: tuple[ClassRule, ...]
    drops_missing_ids: bool = False
    """Boxes with an id below 0 are left out; else they are an error."""
    matches_all_truth: bool = False
    """Results are matched with truth of any label before distractors excuse them; else with class and distractors."""
    excuse_floor: float | None = 0.5
    """Results that match a distractor, or truth too hard to count, with this intersection over union are left out
    (other likenesses: with the threshold of the match); `None`: no result is excused."""
    max_truncation: float | None = None
    """Truth beyond this level, rounded towards 0, is too hard to count."""
    max_occlusion: float | None = None
    drops_ignored: bool = False
    """Truth marked `ignore` doesn't count, and excuses nothing."""
    min_height_px: float | None = None
    """Unmatched results up to this height are left out."""
    region_label: str = ""
    """Truth of this label is regions: unmatched results of which more than `region_share` lies in one are left out."""
    region_share: float = 0.5
    only_labels: frozenset[str] = field(default_factory=frozenset)
    """Results of other labels are an error; empty: they are left out where they aren't of the class."""
    known_labels: frozenset[str] = field(default_factory=frozenset)
    """Truth of other labels is an error; empty: it isn't looked at."""
    order: Literal["as given", "by content"] = "as given"
    """Which rows of a step go first where several pairings are equally good: those given first, as in the reference
    tools, or those with the smaller box, which doesn't depend on how results are written down."""

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored; empty: any are."""
        return self.only_labels or frozenset().union(*(rule.labels for rule in self.classes))


HALF = Match("iou2d", 0.5)
"""What all of these benchmarks match by."""

KITTI = Preparation(
    (
        ClassRule("car", frozenset({"car", "car_2"}), frozenset({"van"})),
        ClassRule("pedestrian", frozenset({"pedestrian"}), frozenset({"person", "person_sitting"})),
    ),
    drops_missing_ids=True, max_truncation=0, max_occlusion=2, min_height_px=25, region_label="dontcare",
)  # fmt: skip
"""TrackEval 1.3.0, `datasets/kitti_2d_box.py`, where 'car_2' is a car too; its 'person' is KITTI's sitting person under
one of two names."""

_MOT_DISTRACTORS = frozenset({"person on vehicle", "static person", "distractor", "reflection"})
_MOT_OTHERS = frozenset(
    {"pedestrian", "car", "bicycle", "motorbike", "non motorized vehicle", "occluder", "occluder on the ground",
     "occluder full", "crowd"}
)  # fmt: skip
_MOT_RESULTS = frozenset({"pedestrian", "", "0", "-1"})

MOT17 = Preparation(
    (ClassRule("pedestrian", frozenset({"pedestrian"}), _MOT_DISTRACTORS),),
    matches_all_truth=True, drops_ignored=True, only_labels=_MOT_RESULTS, known_labels=_MOT_DISTRACTORS | _MOT_OTHERS,
)  # fmt: skip
"""TrackEval 1.3.0, `datasets/mot_challenge_2d_box.py`, benchmarks MOT16 and MOT17."""
MOT20 = Preparation(
    (ClassRule("pedestrian", frozenset({"pedestrian"}), _MOT_DISTRACTORS | {"non motorized vehicle"}),),
    matches_all_truth=True, drops_ignored=True, only_labels=_MOT_RESULTS, known_labels=_MOT_DISTRACTORS | _MOT_OTHERS,
)  # fmt: skip
MOT15 = Preparation((ClassRule("pedestrian"),), excuse_floor=None, drops_ignored=True, only_labels=_MOT_RESULTS)
"""Its truth has no classes, so that nothing is excused."""
EVERYTHING = Preparation((ClassRule("object"),), excuse_floor=None, drops_ignored=True)
"""All boxes as one class: what a tool that knows nothing of benchmarks counts."""
