"""The request of an export: what is to be exported, in which format."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, get_args

from fbench.replay.contracts.errors import ConfigError, did_you_mean

Format = Literal["kitti", "kitti-tracking", "mot", "nuscenes", "nuscenes-tracking"]
Which = Literal["tracks", "detections", "truth"]
FORMATS: tuple[Format, ...] = get_args(Format)
_TRACKING: tuple[Format, ...] = ("kitti-tracking", "mot", "nuscenes-tracking")
_WHICH: tuple[Which, ...] = get_args(Which)


@dataclass(frozen=True)
class ExportWish:
    """What is asked for."""

    format: Format
    boxes: Which | None = None
    """`None`: of a run its tracks or detections, as the format goes; of a log its truth."""
    camera: str = ""
    """Whose image 2D boxes are in; empty: that of KITTI's labels in a log of KITTI, else the only one."""
    frame: str = ""
    """`body` or a camera, in whose coordinates KITTI's 3D boxes are written; empty: as the log says, else `camera`."""
    class_name: str = ""
    """Class of boxes that have none, as the format calls it."""

    @property
    def is_tracking(self) -> bool:
        """Whether boxes need ids."""
        return self.format in _TRACKING

    @property
    def is_nuscenes(self) -> bool:
        """Whether the result is one file of boxes in the world."""
        return self.format.startswith("nuscenes")


@dataclass
class LeftOut:
    """Counts boxes that the format has no place for, by the reason."""

    counts: Counter[str] = field(default_factory=Counter)

    def add(self, reason: str, num: int) -> None:
        """Count some."""
        if num:
            self.counts[reason] += num


def make_wish(form: str, boxes: str | None, camera: str, frame: str, class_name: str) -> ExportWish:
    """Read `--format`, `--boxes`, `--camera`, `--frame` and `--class`.

    Raises:
        ConfigError: where a format or a kind of boxes isn't known.
    """
    chosen = next((known for known in FORMATS if known == form), None)
    if chosen is None:
        raise ConfigError(f"--format {form}: isn't known{did_you_mean(form, FORMATS)}")
    which = next((known for known in _WHICH if known == boxes), None)
    if which is None and boxes is not None:
        raise ConfigError(f"--boxes {boxes}: isn't known{did_you_mean(boxes, _WHICH)}")
    return ExportWish(chosen, which, camera, frame, class_name)
