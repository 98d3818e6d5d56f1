"""What nuscenes-devkit 1.2.0 refuses in a submission, or what can't be meant so."""

from collections.abc import Mapping, Sequence
from typing import Any

from fbench.metrics.files.doubts import Doubt
from fbench.replay.export.attributes import NAMES as ATTRIBUTES


def doubts_about(token: str, boxes: Sequence[Mapping[str, Any]], scene: str) -> list[Doubt]:
    """Return what is odd about the boxes under one sample."""
    where = f"{f'scene {scene}, ' if scene else ''}sample '{token[:40]}'"
    flat = [box for box in boxes if "tracking_name" not in box]
    strange = [box for box in flat if box.get("attribute_name") and box["attribute_name"] not in ATTRIBUTES]
    nums = {
        "box whose sample_token names another sample than it is under":
            sum(box.get("sample_token", token) != token for box in boxes),
        "box with an attribute that nuScenes doesn't have": len(strange),
        "box without a velocity, which counts as unknown": sum(box.get("velocity") is None for box in flat),
    }  # fmt: skip
    return [Doubt(what, num, where) for what, num in nums.items() if num]
