"""A layout for Foxglove and Lichtblick: the scene from above, each camera with its boxes, and the notes on frames."""

from collections.abc import Sequence
from typing import Any

from fbench.reports.overlay.draw import plain_name

_MOST_CAMERAS = 6  # More pictures are too small to see anything


def layout(cameras: Sequence[str], sides: Sequence[str], topics: str, body: str, *, has_world: bool) -> dict[str, Any]:
    """Return the layout for boxes of `sides` below `topics`, around `body`, for logs with images at `/CAMERA/image`."""
    shown = [*sides, *(["trails"] if has_world else [])]
    panels: dict[str, dict[str, Any]] = {
        "3D!scene": {
            "followMode": "follow-pose",
            "followTf": body,
            "cameraState": {
                "distance": 60, "perspective": True, "phi": 45, "thetaOffset": 90, "target": [0, 0, 0],
                "targetOffset": [10, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.5, "far": 5000,
            },
            "scene": {"transforms": {"visible": False}},
            "topics": {f"{topics}/{name}": {"visible": True} for name in shown},
            "layers": {"grid": {
                "layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True, "frameId": body,
                "size": 100, "divisions": 10, "lineWidth": 1, "color": "#80808080", "position": [0, 0, 0],
                "rotation": [0, 0, 0], "order": 1,
            }},
        },
        "RosOut!notes": {"searchTerms": [], "minLogLevel": 2, "topicToRender": f"{topics}/log"},
    }  # fmt: skip
    pictures = [plain_name(name) for name in cameras[:_MOST_CAMERAS]]
    for number, name in enumerate(pictures):
        panels[f"Image!camera{number}"] = {
            "imageMode": {
                "imageTopic": f"/{name}/image",
                "calibrationTopic": f"/{name}/calibration",
                "annotations": {f"{topics}/{side}/{name}": {"visible": True} for side in sides},
                # Frames have the stamp of their reference sensor, not of each image.
                "synchronize": False,
            }
        }
    column = _stack([*(f"Image!camera{number}" for number in range(len(pictures))), "RosOut!notes"])
    view = {"first": "3D!scene", "second": column, "direction": "row", "splitPercentage": 60}
    return {
        "configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}, "layout": view
    }  # fmt: skip


def _stack(names: Sequence[str]) -> str | dict[str, Any]:
    """Put panels of one height below each other."""
    if len(names) == 1:
        return names[0]
    return {
        "first": names[0], "second": _stack(names[1:]), "direction": "column", "splitPercentage": 100 / len(names)
    }  # fmt: skip
