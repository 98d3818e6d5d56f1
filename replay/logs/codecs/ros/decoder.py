"""Decoding of small ROS messages through rosbags: fields, calibration, transforms and radar returns."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Message, RadarScan
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import Origin, Probe, TruthPart
from fbench.replay.logs.codecs.ros.cursor import CDR, ROS1, Header, nanoseconds, plain_frame
from fbench.replay.logs.codecs.ros.definitions import Types
from fbench.replay.logs.coordinate_frames import Edge

MAX_BYTES = 8 * 1024 * 1024  # Of a message without bulk data; 10,000 detections have less

Decode = Callable[[memoryview], Any]


def decoder(name: str, types: Types, encoding: str) -> Decode:
    """Return a function from payloads to message objects, whose attributes are the fields.

    The function raises DecodeError where a payload is damaged or larger than `MAX_BYTES`. Raises DecodeError where
    rosbags can't make code of the types.
    """
    from rosbags.typesys.store import Typestore

    store = Typestore()
    _register(store, name, types)
    read = store.deserialize_cdr if encoding == CDR else store.deserialize_ros1
    return lambda data: _decode(read, name, data)


def _register(store: Any, name: str, types: Types) -> None:
    from rosbags.typesys import TypesysError

    try:
        store.register(types)
        store.get_msgdef(name)
    except TypesysError as error:
        raise DecodeError(f"definition of {name} can't be used ({error})") from error
    except (ValueError, TypeError, AssertionError, KeyError, RecursionError) as error:
        raise DecodeError(f"definition of {name} can't be used ({error})") from error


def _decode(read: Callable[[memoryview, str], object], name: str, data: memoryview) -> Any:
    from rosbags.serde import SerdeError

    if len(data) > MAX_BYTES:
        raise DecodeError(f"{name} of {len(data)} bytes, more than {MAX_BYTES}")
    try:
        return read(data, name)
    except SerdeError as error:
        raise DecodeError(str(error).rstrip(".")) from error
    except (struct.error, ValueError, IndexError, TypeError, AssertionError, KeyError, OverflowError) as error:
        raise DecodeError(f"not a {name} ({error})") from error


def get(message: Any, *names: str) -> Any:
    """The first of these fields that a message has. Raises DecodeError where it has none."""
    value = find(message, *names)
    if value is None:
        raise DecodeError(f"message has no field '{names[0]}'")
    return value


def find(message: Any, *names: str) -> Any:
    """The first of these fields that a message has, else `None`."""
    fields: dict[str, Any] = vars(message)
    return next((fields[name] for name in names if name in fields), None)


def header(message: Any, encoding: str) -> Header:
    """Stamp and coordinate frame of a message with a header; seconds of ROS 1 are unsigned. Raises DecodeError where it
    has no header, or the stamp is out of range.
    """
    part = get(message, "header")
    stamp = get(part, "stamp")
    sec = get(stamp, "sec") & 0xFFFFFFFF if encoding == ROS1 else get(stamp, "sec")
    return Header(nanoseconds(sec, get(stamp, "nanosec")), plain_frame(get(part, "frame_id")))


@dataclass(frozen=True)
class Reads:
    """Functions from payloads to what they hold; `None` where a type holds no such thing."""

    kinds: tuple[str, ...]
    probe: Callable[[memoryview], Probe]
    message: Callable[[str, memoryview, Origin], Message] | None = None
    transforms: Callable[[memoryview], Sequence[tuple[str, Edge]]] | None = None
    stamps: Callable[[memoryview], Sequence[int]] | None = None  # Of the transforms
    calibration: Callable[[memoryview], tuple[str, CameraModel]] | None = None
    truth: Callable[[memoryview, Origin], TruthPart] | None = None


_MODELS = {"equidistant": "fisheye", "kannala_brandt": "fisheye"}
"""What fbench calls a distortion model that ROS calls otherwise."""


def camera_model(info: Any, frame_id: str) -> CameraModel:
    """Return the intrinsics of the images that are published with a CameraInfo: binning and region are applied.

    A pixel of b x b binned ones has its center at b u + (b - 1) / 2, so c' = (c - offset + 0.5) / b - 0.5. Raises
    DecodeError where the camera isn't calibrated, or the numbers can't be those of a camera.
    """
    K = np.array(get(info, "k", "K"), np.float64).reshape(3, 3)
    distortion = np.array(get(info, "d", "D"), np.float64).reshape(-1)
    if not K.any():
        raise DecodeError(f"camera '{frame_id}' isn't calibrated (K is zero)")
    if not (np.isfinite(K).all() and np.isfinite(distortion).all() and K[0, 0] > 0 and K[1, 1] > 0):
        raise DecodeError(f"camera '{frame_id}' has no valid focal length, center and distortion")
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
