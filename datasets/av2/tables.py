"""Feather files of Argoverse 2: tables whose columns are checked, poses, calibration, sweeps and annotations."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import feather

from fbench.datasets.importing.files import is_pinhole, mount_of
from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.contracts.importing import read_bytes
from fbench.replay.data.arrays import Array, Float64, Int64, Text, text_array
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes3D
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.data.scores import format_count
from fbench.replay.formats.export_request import AV2_CLASSES
from fbench.replay.geometry.transforms import pose_matrix, yaw_pitch_roll

CALIBRATION, MOUNTS, LENSES = "calibration", "egovehicle_SE3_sensor.feather", "intrinsics.feather"
LIDAR, MOUNTED = "lidar", "up_lidar"
"""Sweeps hold points of two LiDARs, one above the other, in the ego's coordinates; rays begin near the upper one."""
LABELS = {**AV2_CLASSES, "ANIMAL": "other", "OFFICIAL_SIGNALER": "pedestrian", "RAILED_VEHICLE": "other",
          "TRAFFIC_LIGHT_TRAILER": "other"}  # fmt: skip
"""All categories of the set; any other becomes `other` too. A rider and what is ridden have boxes of their own."""
MAX_ROWS = 20_000_000
_PLACE, _TURN, _SIZE = ("tx_m", "ty_m", "tz_m"), ("qw", "qx", "qy", "qz"), ("length_m", "width_m", "height_m")
_POSE = dict.fromkeys((*_TURN, *_PLACE), "f")
Columns = Mapping[str, Array]


def read_table(path: Path, kinds: Mapping[str, str]) -> Columns:
    """Return the wanted columns of a Feather file, by name: of integers (`i`), finite numbers (`f`) or texts (`U`).

    Raises LogError where the file can't be read, isn't Feather, or a column is missing, isn't of its kind, or has an
    empty or infinite value.
    """
    try:
        table = feather.read_table(pa.BufferReader(read_bytes(path)), columns=None, memory_map=False)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise LogError(f"{path}: isn't a Feather file, or is truncated") from error
    if table.num_rows > MAX_ROWS:
        raise LimitError(f"{path}: {table.num_rows} rows, more than {MAX_ROWS}")
    found: dict[str, Array] = {}
    for name, kind in kinds.items():
        if table.column_names.count(name) != 1:
            raise LogError(f"{path}: {'no' if name not in table.column_names else 'more than one'} column '{name}'")
        column = table.column(name)
        if column.null_count:
            raise LogError(f"{path}: column '{name}' has {format_count(column.null_count, 'empty value')}")
        is_text = pa.types.is_string(column.type) or pa.types.is_large_string(column.type)
        fits = {
            "U": is_text, "i": pa.types.is_integer(column.type),
            "f": pa.types.is_floating(column.type) or pa.types.is_integer(column.type),
        }  # fmt: skip
        if not fits[kind]:
            wanted = {"U": "text", "i": "integers", "f": "numbers"}[kind]
            raise LogError(f"{path}: column '{name}' is {column.type}, expected {wanted}")
        values = text_array(column.to_pylist()) if is_text else column.to_numpy()
        if kind == "f" and len(bad := np.flatnonzero(~(np.abs(values.astype(np.float64)) < MAX_MAGNITUDE))):
            raise LogError(f"{path}: row {bad[0]}: {name} is {values[bad[0]]}, expected a finite number")
        found[name] = values
    return found


def _stack(columns: Columns, names: tuple[str, ...]) -> Float64:
    return np.column_stack([columns[name] for name in names]).astype(np.float64)


def _turns(columns: Columns, path: Path) -> Float64:
    """Quaternions (N, 4) as x, y, z, w. Raises LogError for one that isn't of unit length."""
    wxyz = _stack(columns, _TURN)
    if len(bad := np.flatnonzero(np.abs((wxyz**2).sum(axis=1) - 1) > 1e-3)):
        texts = " ".join(f"{value:g}" for value in wxyz[bad[0]])
        raise LogError(f"{path}: row {bad[0]}: qw qx qy qz isn't a unit quaternion: {texts}")
    return wxyz[:, [1, 2, 3, 0]]


def read_poses(path: Path) -> tuple[Int64, Float64, Float64]:
    """Stamps (N,) [ns], ascending, positions (N, 3) [m] and quaternions (N, 4) of the ego in the city's coordinates."""
    columns = read_table(path, {"timestamp_ns": "i", **_POSE})
    stamp_ns = columns["timestamp_ns"].astype(np.int64)
    if not len(stamp_ns):
        raise LogError(f"{path}: no poses")
    order = np.argsort(stamp_ns, kind="stable")
    if (np.diff(stamp_ns[order]) == 0).any():
        raise LogError(f"{path}: two poses of one instant, {stamp_ns[order][np.argmin(np.diff(stamp_ns[order]))]}")
    return stamp_ns[order], _stack(columns, _PLACE)[order], _turns(columns, path)[order]


def read_rig(folder: Path, cameras: tuple[str, ...], has_lidar: bool) -> Rig:
    """Return the rig of the sensors that have files. Raises LogError where a file of the calibration is missing or
    wrong, or lacks one of them. The images are undistorted, so k1, k2, k3 aren't used (av2-api projects by K alone).
    """
    if not cameras and not has_lidar:
        return Rig({}, {})
    path = folder / MOUNTS
    columns = read_table(path, {"sensor_name": "U", **_POSE})
    places, turns = _stack(columns, _PLACE), _turns(columns, path)
    row_of = {name: row for row, name in enumerate(columns["sensor_name"].tolist())}
    mounts: dict[str, Mount] = {}
    models: dict[str, CameraModel] = {}
    for name in (*cameras, *((MOUNTED,) if has_lidar else ())):
        if name not in row_of:
            raise LogError(f"{path}: no sensor '{name}', of which there are files")
    if has_lidar:  # with the axes of the body, in which its points are given
        mounts[LIDAR] = Mount("lidar", places[row_of[MOUNTED]], np.array([0.0, 0.0, 0.0, 1.0]))
    if cameras:
        path = folder / LENSES
        names = ("fx_px", "fy_px", "cx_px", "cy_px")
        own = read_table(path, {"sensor_name": "U", **dict.fromkeys(names, "f"), "width_px": "i", "height_px": "i"})
        known = {name: row for row, name in enumerate(own["sensor_name"].tolist())}
        for name in cameras:
            if name not in known:
                raise LogError(f"{path}: no camera '{name}', of which there are images")
            fx, fy, cx, cy = (float(own[column][known[name]]) for column in names)
            K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
            size_wh = int(own["width_px"][known[name]]), int(own["height_px"][known[name]])
            if not is_pinhole(K) or min(size_wh) <= 0:
                raise LogError(f"{path}: '{name}': a camera needs focal lengths and sizes above 0")
            models[name] = CameraModel(K, size_wh)
            row = row_of[name]
            mounts[name] = mount_of("camera", pose_matrix(places[row], turns[row]))
    return Rig(dict(sorted(mounts.items())), dict(sorted(models.items())))


def read_sweep(path: Path, stamp_ns: int, origin_m: Float64, number: int) -> PointCloud:
    """Return a sweep as seen from the LiDAR at `origin_m` (3,) on the body, whose axes it has.

    Points are compensated for the ego's motion already, as the log's metadata say.
    """
    integers = {"laser_number": 2**16, "offset_ns": 2**31}
    columns = read_table(path, {"x": "f", "y": "f", "z": "f", "intensity": "i", **dict.fromkeys(integers, "i")})
    for name, limit in integers.items():
        values = columns[name]
        if len(values) and not (values.min() >= 0 and values.max() < limit):
            raise LogError(f"{path}: {name} from {values.min()} to {values.max()}, expected 0 to {limit - 1}")
    xyz = (_stack(columns, ("x", "y", "z")) - origin_m).astype(np.float32)
    intensity, ring = columns["intensity"].astype(np.float32), columns["laser_number"].astype(np.uint16)
    offset_ns = columns["offset_ns"].astype(np.int32)
    return PointCloud(LIDAR, stamp_ns, stamp_ns, xyz, intensity, ring, offset_ns, number)


class Annotations:
    """The boxes of one log."""

    def __init__(self, path: Path) -> None:
        """Read all. Raises LogError where the file can't be used, or a box has no size."""
        kinds = {
            "timestamp_ns": "i", "track_uuid": "U", "category": "U", **dict.fromkeys(_SIZE, "f"), **_POSE,
            "num_interior_pts": "i",
        }  # fmt: skip
        columns = read_table(path, kinds)
        size = _stack(columns, _SIZE)
        if len(bad := np.flatnonzero((size <= 0).any(axis=1))):
            texts = " ".join(f"{value:g}" for value in size[bad[0]])
            raise LogError(f"{path}: row {bad[0]}: length_m width_m height_m are {texts}, expected above 0")
        stamp_ns = columns["timestamp_ns"].astype(np.int64)
        order = np.argsort(stamp_ns, kind="stable")
        ids = {name: i for i, name in enumerate(dict.fromkeys(columns["track_uuid"][order].tolist()), 1)}
        track = np.array([ids[name] for name in columns["track_uuid"][order].tolist()], np.int64)
        pairs = np.lexsort((track, stamp_ns[order]))
        same = (np.diff(stamp_ns[order][pairs]) == 0) & (np.diff(track[pairs]) == 0)
        if same.any():
            row = order[pairs[1:][same][0]]
            raise LogError(f"{path}: row {row}: track {columns['track_uuid'][row]} is twice at {stamp_ns[row]}")
        angles = np.array([yaw_pitch_roll(turn) for turn in _turns(columns, path)[order].tolist()]).reshape(-1, 3)
        self.stamp_ns: Int64 = stamp_ns[order]
        self.categories: Text = columns["category"][order]
        self.num_tracks = len(ids)
        self._boxes = Boxes3D(
            center_m=_stack(columns, _PLACE)[order],
            size_lwh_m=size[order],
            yaw_rad=angles[:, 0],
            pitch_rad=angles[:, 1],
            roll_rad=angles[:, 2],
            label=text_array([LABELS.get(name, "other") for name in self.categories.tolist()]),
            track_id=track,
            num_lidar_pts=columns["num_interior_pts"][order].astype(np.int64),
            source_label=self.categories,
        )

    def boxes(self, stamp_ns: int) -> Boxes3D:
        """Return the boxes of an instant in the ego's coordinates; `track_id` counts tracks by appearance from 1 on."""
        return self._boxes[slice(*np.searchsorted(self.stamp_ns, (stamp_ns, stamp_ns + 1)))]
