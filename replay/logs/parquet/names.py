"""Topics of fbench's own streams, and file names for topics."""

import re
from collections.abc import Collection

from fbench.replay.logs.foxglove.topics import BOXES2D, BOXES3D
from fbench.replay.logs.parquet.columns import StreamKind

_MAX_NAME = 80


def default_topic(kind: StreamKind, sensor: str) -> str:
    """Topic of a stream as in fbench's MCAP logs, so that canonical order is the same in both."""
    match kind:
        case "camera":
            return f"/{sensor}/image"
        case "lidar" | "radar":
            return f"/{sensor}/points"
        case "pose":
            return "/pose"
        case "truth_2d":
            return BOXES2D
        case "truth_3d":
            return BOXES3D
        case "raw":
            return ""


def file_name(topic: str, taken: Collection[str]) -> str:
    """Return a name for the file of a topic: plain ASCII, different from those `taken` even where case doesn't count.

    `taken` holds names in lower case.
    """
    plain = re.sub(r"[^A-Za-z0-9_-]+", ".", topic).strip("._-")[:_MAX_NAME].rstrip("._-") or "stream"
    name, number = f"{plain}.parquet", 1
    while name.lower() in taken:
        number += 1
        name = f"{plain}-{number}.parquet"
    return name
