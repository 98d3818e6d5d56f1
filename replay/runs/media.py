"""Images and points of a few frames, kept in the run folder so that a report needs no log."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import MissingPackageError
from fbench.replay.data.arrays import Float32
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import Pixels, decode, encode_jpeg, scale_down
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.transforms import transform
from fbench.replay.runs.columns import bytes_column, number_column, text_column
from fbench.replay.runs.tables import read_table, write_table

MAX_WIDTH_PX = 640
MAX_POINTS = 10_000
_SCALE = 100.0  # Points are kept in whole cm, their speeds in cm/s
_NO_SPEED = -32768


@dataclass(frozen=True, eq=False)
class Picture:
    """A camera image, scaled down."""

    jpeg: bytes
    size_wh: tuple[int, int]  # Of the picture itself; the camera model's size is that of the original [px]


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a LiDAR or radar, thinned out."""

    xyz: Float32  # (N, 3) in body coordinates [m]
    speed_mps: Float32  # (N,) radial velocity, positive receding; NaN where the sensor doesn't measure it


@dataclass(frozen=True, eq=False)
class MediaFrame:
    """What is kept of one frame."""

    index: int
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    points: Mapping[str, Points] = field(default_factory=dict)


class MediaKeeper:
    """Keeps between `num` and 2 `num` frames, evenly spread, whatever the length of the log.

    Every `stride`-th frame is kept; when there are too many, the stride doubles and every second one goes.
    """

    def __init__(self, num: int = 24) -> None:
        self._num, self._stride, self._num_offered = num, 1, 0
        self._kept: list[MediaFrame] = []
        self.sizes_wh: dict[str, tuple[int, int]] = {}  # Of the first image of each camera that isn't calibrated [px]

    def offer(self, rig: Rig, frame: Frame) -> None:
        """Keep the frame, measured by a rig, if its turn has come."""
        for name, message in frame.messages.items():
            if isinstance(message, Image) and name not in rig.cameras:
                self.sizes_wh.setdefault(name, message.size_wh)
        self._num_offered += 1
        if self._num == 0 or (self._num_offered - 1) % self._stride:
            return
        self._kept.append(keep(rig, frame))
        if len(self._kept) >= 2 * self._num:
            self._kept, self._stride = self._kept[::2], self._stride * 2

    @property
    def frames(self) -> Sequence[MediaFrame]:
        """The frames kept so far."""
        return self._kept


def keep(rig: Rig, frame: Frame) -> MediaFrame:
    """Scale images down and thin points out; an image that can't be decoded is left out, as video is without PyAV."""
    messages = sorted(frame.messages.items())
    pictures: dict[str, Picture] = {}
    for name, m in messages:
        if isinstance(m, Image) and (pixels := _decode(m)) is not None:
            small = scale_down(pixels, MAX_WIDTH_PX)
            pictures[name] = Picture(encode_jpeg(small), (small.shape[1], small.shape[0]))
    points = {name: _points(rig, m) for name, m in messages if isinstance(m, PointCloud | RadarScan)}
    return MediaFrame(frame.index, pictures, points)


def _decode(image: Image) -> Pixels | None:
    with suppress(MissingPackageError):
        return decode(image)
    return None


def _points(rig: Rig, message: PointCloud | RadarScan) -> Points:
    step = max(1, -(-len(message.xyz) // MAX_POINTS))
    xyz = transform(rig.body_T_sensor(message.sensor), message.xyz[::step]).astype(np.float32)
    measured = message.radial_velocity_mps if isinstance(message, RadarScan) else None
    speed = np.full(len(xyz), np.nan, np.float32) if measured is None else measured[::step]
    return Points(xyz, speed)


def thin(points: Points, most: int) -> Points:
    """Return at most so many points, evenly spread."""
    num = len(points.xyz)
    rows = np.arange(min(num, most)) * num // max(1, min(num, most))
    return Points(points.xyz[rows], points.speed_mps[rows])


def pack_points(points: Points) -> bytes:
    """Return points as little-endian int16 (N, 4): x, y, z [cm], radial velocity [cm/s], -32768 where there is none.
    What is farther away than 327 m is put there.
    """
    table = np.concatenate([points.xyz, points.speed_mps[:, None]], axis=1).astype(np.float64)
    whole = np.clip(np.round(table * _SCALE), -32767, 32767)
    return np.where(np.isfinite(table), whole, _NO_SPEED).astype("<i2").tobytes()


def _unpack_points(data: bytes) -> Points:
    whole = np.frombuffer(data, "<i2").reshape(-1, 4)
    values = np.where(whole == _NO_SPEED, np.float32(np.nan), whole.astype(np.float32) / np.float32(_SCALE))
    return Points(values[:, :3].astype(np.float32), values[:, 3].astype(np.float32))


def write_media(path: Path, frames: Sequence[MediaFrame]) -> None:
    """Write one row a picture or cloud."""
    rows: list[tuple[int, str, str, int, int, bytes]] = []
    for frame in frames:
        rows += [(frame.index, "picture", name, *p.size_wh, p.jpeg) for name, p in sorted(frame.pictures.items())]
        for name, points in sorted(frame.points.items()):
            rows.append((frame.index, "points_cm", name, len(points.xyz), 4, pack_points(points)))
    numbers = {
        name: np.array([row[i] for row in rows], np.int64) for i, name in ((0, "frame"), (3, "width"), (4, "height"))
    }
    columns = {
        "frame": number_column(numbers["frame"], pa.int64()),
        "kind": text_column([row[1] for row in rows]),
        "sensor": text_column([row[2] for row in rows]),
        "width": number_column(numbers["width"], pa.int64()),
        "height": number_column(numbers["height"], pa.int64()),
        "data": bytes_column([row[5] for row in rows]),
    }
    write_table(path, columns)


def read_media(path: Path) -> tuple[MediaFrame, ...]:
    """Read what `write_media` wrote; nothing where the run kept no media."""
    if not path.is_file():
        return ()
    frames: dict[int, tuple[dict[str, Picture], dict[str, Points]]] = {}
    for row in read_table(path).to_pylist():
        pictures, points = frames.setdefault(row["frame"], ({}, {}))
        if row["kind"] == "picture":
            pictures[row["sensor"]] = Picture(row["data"], (row["width"], row["height"]))
        elif row["kind"] == "points_cm":
            points[row["sensor"]] = _unpack_points(row["data"])
        else:  # Of older versions
            values = np.frombuffer(row["data"], "<f4").reshape(-1, 4)
            points[row["sensor"]] = Points(values[:, :3], values[:, 3])
    return tuple(MediaFrame(index, *content) for index, content in sorted(frames.items()))
