"""CameraInfo, transforms and radar returns."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import RadarScan
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import Origin
from fbench.replay.logs.codecs.ros.cursor import plain_frame
from fbench.replay.logs.codecs.ros.decoder import get
from fbench.replay.logs.coordinate_frames import Edge

_MODELS = {"equidistant": "fisheye", "kannala_brandt": "fisheye"}
"""What fbench calls a distortion model that ROS calls otherwise."""


def camera_model(info: Any, frame_id: str) -> CameraModel:
    """Return the intrinsics of the images that are published with a CameraInfo: binning and region are applied.

    A pixel of b x b binned ones has its centre at b u + (b - 1) / 2, so c' = (c - offset + 0.5) / b - 0.5.

    Raises:
        DecodeError: where the camera isn't calibrated, or the numbers can't be those of a camera.
    """
    K = np.array(get(info, "k", "K"), np.float64).reshape(3, 3)
    distortion = np.array(get(info, "d", "D"), np.float64).reshape(-1)
    if not K.any():
        raise DecodeError(f"camera '{frame_id}' isn't calibrated (K is zero)")
    if not (np.isfinite(K).all() and np.isfinite(distortion).all() and K[0, 0] > 0 and K[1, 1] > 0):
        raise DecodeError(f"camera '{frame_id}' has no valid focal length, centre and distortion")
    model = str(get(info, "distortion_model"))
    size_wh = _apply_region(info, K, frame_id)
    return CameraModel(K, size_wh, _MODELS.get(model, model), distortion)


def _apply_region(info: Any, K: Float64, frame_id: str) -> tuple[int, int]:
    """Change `K` to that of the region, then of the binned image; return the size of the image."""
    roi, full = get(info, "roi"), (int(get(info, "width")), int(get(info, "height")))
    offset = (int(get(roi, "x_offset")), int(get(roi, "y_offset")))
    region = (int(get(roi, "width")) or full[0], int(get(roi, "height")) or full[1])
    binning = (max(1, int(get(info, "binning_x"))), max(1, int(get(info, "binning_y"))))
    if any(o + r > f for o, r, f in zip(offset, region, full, strict=True)):
        raise DecodeError(
            f"camera '{frame_id}' has a region of {region} at {offset} outside its {full[0]}x{full[1]} px"
        )
    for axis in range(2):
        if offset[axis] or binning[axis] > 1:
            K[axis, 2] = (K[axis, 2] - offset[axis] + 0.5) / binning[axis] - 0.5
            K[axis, :2] /= binning[axis]
    width, height = region[0] // binning[0], region[1] // binning[1]
    if not (width and height):
        raise DecodeError(f"camera '{frame_id}' has an image size of {width}x{height}")
    return width, height


def edges(message: Any) -> Sequence[tuple[str, Edge]]:
    """Return child and edge of each transform of a TFMessage."""
    return [_edge(part) for part in get(message, "transforms")]


def _edge(part: Any) -> tuple[str, Edge]:
    parent = plain_frame(get(get(part, "header"), "frame_id"))
    pose = get(part, "transform")
    t, q = get(pose, "translation"), get(pose, "rotation")
    edge = Edge(parent, _array(t, "xyz"), _array(q, "xyzw"))
    return plain_frame(get(part, "child_frame_id")), edge


def _array(part: Any, names: str) -> Float64:
    return np.array([get(part, name) for name in names], np.float64)


_FIELDS = ("range", "azimuth", "elevation", "doppler_velocity", "amplitude")


def radar_scan(message: Any, stamp_ns: int, origin: Origin) -> RadarScan:
    """Return a scan: azimuth positive to the left, elevation upwards (REP 103), x = r cos(el) cos(az).

    radar_msgs doesn't define the sign of `doppler_velocity`: it counts as positive when receding. `amplitude` is in
    dB, so `rcs_dbsm` is an uncalibrated magnitude.
    """
    returns = [[get(point, name) for name in _FIELDS] for point in get(message, "returns")]
    table = np.array(returns, np.float64).reshape(-1, len(_FIELDS))
    distance, azimuth, elevation = table[:, 0], table[:, 1], table[:, 2]
    flat = distance * np.cos(elevation)
    xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
    polar, xyz32 = table.astype(np.float32), xyz.astype(np.float32)
    return RadarScan(
        origin.sensor, stamp_ns, origin.log_ns, xyz32, polar[:, 3], polar[:, 4], polar[:, 0], polar[:, 1], polar[:, 2],
        origin.frame_number,
    )  # fmt: skip
