"""What must never reach a pipeline: points that aren't finite, images that don't fit their calibration."""

import numpy as np

from fbench.replay.arrays import Float32
from fbench.replay.data import Image, Message, PointCloud, RadarScan, Rig
from fbench.replay.faults import FaultLog
from fbench.replay.finite import C, only_finite
from fbench.replay.skipped import Skipped

MAX_LOST_SHARE = 0.5
"""A cloud with a larger share of non-finite points is skipped whole."""
MAX_RANGE_M = 1000.0
"""Points farther away are taken as they are, but no sensor of a vehicle sees so far."""


def clean(message: Message, rig: Rig, faults: FaultLog) -> Message | Skipped:
    """Drop points with a non-finite coordinate, clouds that consist mostly of them, and images of another size than
    their camera's; count all of these.
    """
    if isinstance(message, PointCloud):
        return _clean_cloud(message, faults)
    if isinstance(message, RadarScan):
        return _clean_cloud(message, faults)
    if isinstance(message, Image):
        return _clean_image(message, rig, faults)
    return message


def _clean_image(image: Image, rig: Rig, faults: FaultLog) -> Image | Skipped:
    camera = rig.cameras.get(image.sensor)
    if camera is None or camera.size_wh == image.size_wh:
        return image
    (width, height), (w, h) = image.size_wh, camera.size_wh
    reason = f"{width}x{height}, but calibrated for {w}x{h}"
    faults.add("LIM003", f"{image.sensor} at {image.stamp_ns} ns: {reason}")
    return Skipped(image.sensor, image.stamp_ns, image.frame_number, reason)


def _clean_cloud(cloud: C, faults: FaultLog) -> C | Skipped:
    where = f"{cloud.sensor} at {cloud.stamp_ns} ns"
    num = len(cloud.xyz)
    if num == 0:
        faults.add("DAT002", where)
        return cloud
    if np.isfinite(cloud.xyz).all():
        _flag_far(where, cloud.xyz, faults)
        return cloud
    finite = only_finite(cloud)
    lost = num - len(finite.xyz)
    if lost > MAX_LOST_SHARE * num:
        faults.add("DAT001", f"{where}: {lost} of {num} points")
        return Skipped(cloud.sensor, cloud.stamp_ns, cloud.frame_number, "mostly non-finite points")
    faults.add("DAT004", f"{where}: {lost} of {num} points")
    _flag_far(where, finite.xyz, faults)
    return finite


def _flag_far(where: str, xyz: Float32, faults: FaultLog) -> None:
    if max(float(xyz.max()), -float(xyz.min())) > MAX_RANGE_M:
        num = int(np.count_nonzero((np.abs(xyz) > MAX_RANGE_M).any(axis=1)))
        faults.add("DAT003", f"{where}: {num} of {len(xyz)} points")
