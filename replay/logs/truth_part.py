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
