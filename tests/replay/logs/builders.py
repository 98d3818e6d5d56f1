"""Logs to write, strategies that fill every field of every data type, and comparison bit for bit."""

from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.protocols import Reader
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log

INFO = LogInfo("log", "id-1", {"place": "Köln"})
NO_RIG = Rig({}, {})


def write(path: Path, items: Iterable[Message | Truth], rig: Rig = NO_RIG, info: LogInfo = INFO, **how: Any) -> Path:
    with McapWriter(path, info, rig, **how) as writer:
        for item in items:
            writer.write(item)
    return path


def read(path: Path) -> tuple[Reader, FaultLog]:
    faults = FaultLog()
    return open_log(path, faults), faults


def canonical(value: Any) -> Any:
    """Nested tuples that are equal exactly where all fields are, arrays by dtype, shape and bytes."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "U":  # the width of the items isn't content
            return ("U", value.shape, value.tolist())
        return (value.dtype.str, value.shape, value.tobytes())
    if is_dataclass(value):
        return (type(value).__name__, *((f.name, canonical(getattr(value, f.name))) for f in fields(value)))
    if isinstance(value, dict):
        return sorted((key, canonical(item)) for key, item in value.items())
    return value


def sequence(num: int = 40, step_ns: int = 50_000_000, points: int = 50) -> list[Message | Truth]:
    """A camera, a LiDAR, a radar, poses and truth, all different from each other."""
    rng = np.random.Generator(np.random.Philox(7))
    items: list[Message | Truth] = []
    for i in range(num):
        stamp = 1_000_000_000 + i * step_ns
        xyz = rng.normal(size=(points, 3)).astype(np.float32)
        items += [
            Image("cam", stamp, stamp + 5, rng.bytes(200), "jpeg", (20, 10)),
            PointCloud("top", stamp, stamp + 3, xyz, xyz[:, 0].copy(), frame_number=i),
            RadarScan("front", stamp, stamp + 3, xyz[:5], xyz[:5, 1].copy()),
            Pose("gnss", stamp, stamp, rng.normal(size=3), np.array([0, 0, 0, 1.0])),
            Truth(stamp, stamp, Boxes3D(rng.normal(size=(2, 3)), np.ones((2, 3)), rng.normal(size=2))),
        ]
    return items


def the_rig() -> Rig:
    third = 1 / 3
    turn = np.array([0.1, -third, 0.2, 0.9])
    mounts = {
        "cam": Mount("camera", np.array([1.7, third, 1.2]), turn),
        "top": Mount("lidar", np.array([0, -0.0, 1.9]), np.array([0, 0, 0, 1.0])),
        "front": Mount("radar", np.array([3.7, 0, 0.4]), -turn),
    }
    K = np.array([[700.1, third, 300], [0, 701, 200.5], [0, 0, 1]])
    return Rig(mounts, {"cam": CameraModel(K, (640, 400), "plumb_bob", np.array([third, -0.1, 0, 0, 1e-300]))})


def numbers(items: Sequence[Any], kind: type) -> list[Any]:
    return [item for item in items if isinstance(item, kind)]


names = st.text(st.characters(codec="utf-8"), min_size=1, max_size=8)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=6)
stamps = st.integers(0, 2**63 - 1)
frame_numbers = st.none() | st.integers(0, 2**32 - 1)
head = {"sensor": names, "stamp_ns": stamps, "log_ns": stamps, "frame_number": frame_numbers}
sizes_wh = st.tuples(st.integers(0, 2**24), st.integers(0, 2**24))


def array(dtype: str, shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    if dtype == "U":
        return st.lists(texts, min_size=shape[0], max_size=shape[0]).map(lambda rows: np.array(rows, dtype=np.str_))
    return hnp.arrays(np.dtype(dtype), shape)


def _bounded(values: np.ndarray) -> np.ndarray:
    """What can be of a rig: finite, below 1e9."""
    return np.where(np.abs(values) < 1e9, values, 1.0)


@st.composite
def structs(draw: Any, kind: type, needed: dict[str, Any], optional: dict[str, Any], **more: Any) -> Any:
    """Objects whose arrays have a common number of rows; optional ones may be absent."""
    num = draw(st.integers(0, 5))

    def column(spec: tuple[str, int]) -> st.SearchStrategy[Any]:
        dtype, width = spec
        return array(dtype, (num,) if width == 1 else (num, width))

    values = {name: draw(column(spec)) for name, spec in needed.items()}
    values |= {name: draw(st.none() | column(spec)) for name, spec in optional.items()}
    return kind(**values, **{name: draw(strategy) for name, strategy in more.items()})


_ONE = ("f8", 1)
_COMMON = {
    "label": ("U", 1), "score": _ONE, "track_id": ("i8", 1), "sources": ("u1", 1), "predicted": ("?", 1),
    "visibility": _ONE, "occlusion": _ONE, "truncation": _ONE, "attribute": ("U", 1), "num_lidar_pts": ("i8", 1),
    "num_radar_pts": ("i8", 1), "ignore": ("?", 1), "source_label": ("U", 1),
}  # fmt: skip
boxes3d = structs(
    Boxes3D,
    {"center_m": ("f8", 3), "size_lwh_m": ("f8", 3), "yaw_rad": _ONE},
    {"roll_rad": _ONE, "pitch_rad": _ONE, "velocity_mps": ("f8", 3), **_COMMON},
)
boxes2d = structs(
    Boxes2D,
    {"camera": ("U", 1), "xyxy_px": ("f8", 4)},
    {"visible_xyxy_px": ("f8", 4), "distance_m": _ONE, "range_rate_mps": _ONE, **_COMMON},
)
truths = st.builds(
    Truth, stamp_ns=stamps, log_ns=stamps, boxes3d=st.none() | boxes3d, boxes2d=st.none() | boxes2d,
    frame_number=frame_numbers,
)  # fmt: skip
clouds = structs(
    PointCloud, {"xyz": ("f4", 3)}, {"intensity": ("f4", 1), "ring": ("u2", 1), "offset_ns": ("i4", 1)}, **head
)
_RADAR = ("radial_velocity_mps", "rcs_dbsm", "range_m", "azimuth_rad", "altitude_rad")
scans = structs(RadarScan, {"xyz": ("f4", 3)}, dict.fromkeys(_RADAR, ("f4", 1)), **head)
poses = st.builds(Pose, **head, translation_m=array("f8", (3,)), rotation_xyzw=array("f8", (4,)))
images = st.builds(
    Image, **head, data=st.binary(max_size=40), encoding=st.sampled_from(["jpeg", "rgb8", "mono8"]) | texts,
    size_wh=sizes_wh,
)  # fmt: skip
mounts = st.builds(
    Mount, kind=st.sampled_from(["camera", "lidar", "radar"]), translation_m=array("f8", (3,)).map(_bounded),
    rotation_xyzw=array("f8", (4,)).map(_bounded).filter(lambda rotation: np.abs(rotation).max() > 1e-100),
)  # fmt: skip
cameras = st.builds(
    CameraModel, K=array("f8", (3, 3)).map(_bounded).filter(lambda K: K[0, 0] > 0 and K[1, 1] > 0),
    size_wh=st.tuples(st.integers(1, 2**32 - 1), st.integers(1, 2**32 - 1)), distortion_model=texts,
    distortion=st.integers(0, 8).flatmap(lambda n: array("f8", (n,)).map(_bounded)),
)  # fmt: skip
