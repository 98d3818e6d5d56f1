"""One message of ground truth, before 3D and 2D of one instant are joined."""

from dataclasses import dataclass

from fbench.replay.data import Truth


@dataclass(frozen=True, eq=False)
class TruthPart:
    """3D boxes, or 2D ones that belong to the 3D ones of the same instant where there are any."""

    truth: Truth
    is_2d: bool
    expects_2d: bool = False
    """Whether 2D boxes of the same instant follow."""
    frame_id: str = ""
    """Coordinate frame of the boxes, of 2D boxes that of the camera; empty: the body, and cameras by name."""
    frame_ids: tuple[str, ...] = ()
    """Coordinate frame of each 3D box, where they are in several; `frame_id` is one of them."""


def part_of(truth: Truth, frame_ids: tuple[str, ...], otherwise: str = "") -> TruthPart:
    """Make a part of 3D boxes that each name a coordinate frame; `otherwise` is that of those which name none."""
    names = tuple(name or otherwise for name in frame_ids)
    first = next((name for name in names if name), otherwise)
    return TruthPart(truth, is_2d=False, frame_id=first, frame_ids=names if len(set(names)) > 1 else ())
