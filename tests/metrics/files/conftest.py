"""Small files of boxes."""

from tests.replay.formats.conftest import Write, write

__all__ = ["Write", "write"]
CAR = "0 0 0.5 {left} 100 {right} 150 1.5 1.6 4.0 {x} 1.7 {z} 0.1"


def kitti_row(frame: int, number: int, name: str = "Car", x: float = 1.0, score: float | None = None) -> str:
    """One object of the tracking benchmark, 10 m ahead."""
    row = f"{frame} {number} {name} " + CAR.format(left=100 + 10 * x, right=150 + 10 * x, x=x, z=10.0)
    return row if score is None else f"{row} {score}"


def kitti_text(num_frames: int, score: float | None = None) -> str:
    """Two cars in each of some frames."""
    rows = [kitti_row(f, i, x=8.0 * i, score=score) for f in range(num_frames) for i in range(2)]
    return "\n".join(rows) + "\n"
