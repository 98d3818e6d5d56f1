"""From fbench's messages to those of ROS 2 and back. Pure: `ros` holds the message classes, so that fakes do as well.

Every sensor's name is its frame_id; boxes are expected in the body's frame.
"""

import math
from typing import Any

import numpy as np

_NS_PER_S = 1_000_000_000
# PointField: offsets follow from the sizes.
_DATATYPES = {"<f4": 7, "<u2": 4, "<i4": 5}
_COLUMNS = {
    "intensity": ("intensity", "<f4"), "ring": ("ring", "<u2"), "offset_ns": ("offset_ns", "<i4"),
    "radial_velocity_mps": ("velocity", "<f4"), "rcs_dbsm": ("rcs", "<f4"), "range_m": ("range", "<f4"),
    "azimuth_rad": ("azimuth", "<f4"), "altitude_rad": ("altitude", "<f4"),
}  # fmt: skip
_COMPRESSED = ("jpeg", "png", "webp")
_ENCODINGS = {"uyvy": "yuv422", "yuyv": "yuv422_yuy2"}
_CHANNELS = {"mono": 1, "bayer": 1, "bgr": 3, "rgb": 3, "bgra": 4, "rgba": 4, "uyvy": 2, "yuyv": 2, "nv21": 1}


def set_stamp(target: Any, stamp_ns: int) -> None:
    """Write a stamp into a builtin_interfaces/Time."""
    target.sec, target.nanosec = divmod(stamp_ns, _NS_PER_S)


def stamp_ns(time: Any) -> int:
    """Read a builtin_interfaces/Time."""
    return int(time.sec) * _NS_PER_S + int(time.nanosec)


def clock(ros: Any, now_ns: int) -> Any:
    """rosgraph_msgs/Clock."""
    message = ros.Clock()
    set_stamp(message.clock, now_ns)
    return message


def points(ros: Any, sensor: str, at_ns: int, columns: dict[str, np.ndarray]) -> Any:
    """sensor_msgs/PointCloud2 from columns of a LiDAR or radar: x, y, z and what the sensor gives."""
    named = {_COLUMNS[name][0]: (array, _COLUMNS[name][1]) for name, array in columns.items() if name != "xyz"}
    xyz = {axis: (columns["xyz"][:, i], "<f4") for i, axis in enumerate("xyz")}
    table = {**xyz, **named}
    dtype = np.dtype([(name, kind) for name, (_, kind) in table.items()])
    rows = np.zeros(len(columns["xyz"]), dtype)
    for name, (array, _) in table.items():
        rows[name] = array
    message = ros.PointCloud2()
    _head(message, sensor, at_ns)
    message.height, message.width = 1, len(rows)
    message.fields = [_field(ros, name, kind, dtype.fields[name][1]) for name, (_, kind) in table.items()]
    message.is_bigendian, message.is_dense = False, bool(np.isfinite(columns["xyz"]).all())
    message.point_step, message.row_step = dtype.itemsize, dtype.itemsize * len(rows)
    message.data = rows.tobytes()
    return message


def _field(ros: Any, name: str, kind: str, offset: int) -> Any:
    field = ros.PointField()
    field.name, field.offset, field.datatype, field.count = name, offset, _DATATYPES[kind], 1
    return field


def image(ros: Any, sensor: str, at_ns: int, source: Any) -> Any:
    """sensor_msgs/CompressedImage, or sensor_msgs/Image where it was recorded raw."""
    if source.encoding in _COMPRESSED:
        message = ros.CompressedImage()
        _head(message, sensor, at_ns)
        message.format, message.data = source.encoding, source.data
        return message
    message = ros.Image()
    _head(message, sensor, at_ns)
    message.height, message.width = source.height_px, source.width_px
    message.encoding = _ENCODINGS.get(source.encoding, source.encoding)
    message.is_bigendian, message.data = 0, source.data
    kind = source.encoding.split("_")[0].rstrip("0123456789") if source.encoding != "nv21" else "nv21"
    message.step = source.width_px * _CHANNELS[kind] * (2 if source.encoding.endswith("16") else 1)
    return message


def camera_info(ros: Any, sensor: Any, at_ns: int) -> Any:
    """sensor_msgs/CameraInfo of an unrectified image."""
    camera, message = sensor.camera, ros.CameraInfo()
    _head(message, sensor.name, at_ns)
    message.width, message.height = camera.width_px, camera.height_px
    message.distortion_model = {"fisheye": "equidistant"}.get(camera.distortion_model, camera.distortion_model)
    message.d, message.k = list(camera.distortion), list(camera.k)
    message.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    k = message.k
    message.p = [*k[0:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0]
    return message


def transform(ros: Any, parent: str, child: str, at_ns: int, pose: Any) -> Any:
    """geometry_msgs/TransformStamped: the pose of `child` in `parent`."""
    message = ros.TransformStamped()
    _head(message, parent, at_ns)
    message.child_frame_id = child
    t, q = message.transform.translation, message.transform.rotation
    t.x, t.y, t.z = pose.translation_m
    q.x, q.y, q.z, q.w = pose.rotation_xyzw
    return message


def _head(message: Any, frame_id: str, at_ns: int) -> None:
    message.header.frame_id = frame_id
    set_stamp(message.header.stamp, at_ns)


def fill_boxes(array: Any, body_frame: str, boxes: Any) -> None:
    """Append the boxes of a vision_msgs/Detection3DArray to a `Boxes3D` of the schema.

    Raises:
        ValueError: where they are in another coordinate frame.
    """
    if array.header.frame_id != body_frame:
        raise ValueError(f"boxes are in frame '{array.header.frame_id}', expected '{body_frame}'")
    ids = [str(detection.id) for detection in array.detections]
    for detection in array.detections:
        center, size = detection.bbox.center, detection.bbox.size
        roll, pitch, yaw = angles(center.orientation)
        boxes.center_m.extend([center.position.x, center.position.y, center.position.z])
        boxes.size_lwh_m.extend([size.x, size.y, size.z])
        boxes.yaw_rad.append(yaw)
        boxes.roll_rad.append(roll)
        boxes.pitch_rad.append(pitch)
        best = max(detection.results, key=lambda result: result.hypothesis.score, default=None)
        boxes.label.append("" if best is None else str(best.hypothesis.class_id))
        boxes.score.append(0.0 if best is None else best.hypothesis.score)
    if all(text.isdecimal() for text in ids):
        boxes.track_id.extend(int(text) for text in ids)


def angles(q: Any) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad] of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x * q.x + q.y * q.y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (q.w * q.y - q.z * q.x))))
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    return roll, pitch, yaw
