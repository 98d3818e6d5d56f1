"""Networks that detect in pillars of LiDAR points, in two files as Autoware's CenterPoint has them: a voxel encoder and
a head.

Layout, features and decoding are those of autoware_universe, `perception/autoware_lidar_centerpoint` (its README,
`preprocess_kernel.cu`, `postprocess_kernel.cu`, and `ros_utils.cpp`). Two things differ, so that the order of points
never decides: of more points than a pillar holds, the first along x, then y, then z count; and of equally sure boxes,
the first along y, then x.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from fbench.pipelines.sensors.bev.grid import NO_RADAR, BevPoints
from fbench.pipelines.sensors.camera.model import ORT_ERRORS, first_line, load
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.rows import suppress
from fbench.replay.contracts.errors import ConfigError, ModelError, did_you_mean
from fbench.replay.data.arrays import Array, Float32, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.classes import label
from fbench.replay.formats.documents import YamlFileError, read_yaml
from fbench.replay.geometry.iou import iou_bev
from fbench.replay.geometry.transforms import wrap_angle

MAX_PILLARS = 40_000  # Of one frame; the first along y, then x count
_OUTPUTS = {"heatmap": 0, "reg": 2, "height": 1, "dim": 3, "rot": 2, "vel": 2}
"""Channels of the head's outputs, in their order; those of the heatmap are the classes. Where the others come with
variances, they have twice as many, of which the second half isn't used.
"""
_LEAST_TURN = (
    0.3  # Vehicles whose sine and cosine are shorter than this together have no heading, and count for nothing
)
_APART_M, _MAX_IOU = 0.5, 0.1  # Of boxes that are nearer, or overlap more, the surest stays
_MAX_CANDIDATES, _MAX_BOXES = 2000, 300  # Of one frame; the surest count
_LARGEST = 3.2  # Of the logarithm of a size: 25 m
_KEYS = ("class_names", "point_cloud_range", "voxel_size", "downsample_factor", "has_twist")
_OTHER_KEYS = ("point_feature_size", "encoder_in_feature_size", "max_voxel_size", "has_variance")
"""Parameters of Autoware's files that the networks tell themselves, though their names are like those that count."""
_BOOLEANS = {"true": True, "yes": True, "on": True, "y": True, "false": False, "no": False, "off": False, "n": False}


@dataclass(frozen=True)
class PillarLayout:
    """What the files don't tell: `*_ml_package.param.yaml` of Autoware; the defaults are those of its CenterPoint."""

    classes: tuple[str, ...] = ("CAR", "TRUCK", "BUS", "BICYCLE", "PEDESTRIAN")
    low_m: tuple[float, ...] = (-76.8, -76.8, -4.0)
    high_m: tuple[float, ...] = (76.8, 76.8, 6.0)
    """Points in between count, in body coordinates whose z is above ground."""
    cell_m: tuple[float, ...] = (0.32, 0.32, 10.0)
    stride: int = 1  # Cells of the input along the edge of a cell of the output
    has_velocity: bool = False  # Whether the network learned velocities

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along y and x."""
        spans = [(self.high_m[k] - self.low_m[k]) / self.cell_m[k] for k in (1, 0)]
        return round(spans[0]), round(spans[1])


def read_layout(path: Path) -> PillarLayout:
    """Read the parameters of a model as Autoware keeps them. Raises ConfigError where the file can't be read, has none,
    or impossible values.
    """
    known, params = PillarLayout(), _find_params(path)
    span = _numbers(path, params, "point_cloud_range", [*known.low_m, *known.high_m])
    cell = _numbers(path, params, "voxel_size", known.cell_m)
    (stride,) = _numbers(path, params, "downsample_factor", [known.stride])
    names = params.get("class_names", [*known.classes])
    if (
        not isinstance(names, list)
        or not names
        or not all(isinstance(n, str) and re.search(r"[^\W\d]", n) for n in names)
    ):
        raise ConfigError(f"{path}: class_names: expected a list of names, got {str(names)[:80]}")
    twist = str(params.get("has_twist", "false"))
    if twist.lower() not in _BOOLEANS:
        raise ConfigError(f"{path}: has_twist: expected true or false, got {twist[:80]}")
    layout = PillarLayout(
        tuple(names), tuple(span[:3]), tuple(span[3:]), tuple(cell), int(stride), _BOOLEANS[twist.lower()]
    )
    spans = [(high - low) / size for low, high, size in zip(layout.low_m, layout.high_m, cell, strict=True)]
    if not all(8 <= side <= 4096 for side in spans[:2]) or spans[2] <= 0 or stride not in (1, 2, 4, 8):
        raise ConfigError(f"{path}: no network has this point_cloud_range, voxel_size, and downsample_factor")
    return layout


def _find_params(path: Path) -> Mapping[str, object]:
    """Return the parameters inside of a file: under `/**`, or the name of any one node, or at its top."""
    try:
        content = read_yaml(path)
    except YamlFileError as error:
        raise ConfigError(f"{path}: {error}") from error
    if isinstance(content, dict) and len(content) == 1 and isinstance(inner := next(iter(content.values())), dict):
        content = inner
    for name in ("ros__parameters", "model_params"):
        if isinstance(content, dict) and name in content:
            content = content[name]
    params = content if isinstance(content, dict) else {}
    missing = [name for name in _KEYS if name not in params]
    for key in params:
        if key not in (*_KEYS, *_OTHER_KEYS) and get_close_matches(key.lower(), missing, cutoff=0.75):
            raise ConfigError(f"{path}: '{key[:80]}' isn't known{did_you_mean(key, missing)}")
    if len(missing) == len(_KEYS):
        raise ConfigError(f"{path}: expected the parameters of one model, such as {', '.join(_KEYS[:3])}; it has none")
    return params


def _numbers(path: Path, params: Mapping[str, object], name: str, default: Sequence[float]) -> list[float]:
    value = params.get(name, [str(number) for number in default])
    texts = value if isinstance(value, list) else [value]
    try:
        found = [float(str(item)) for item in texts]
    except ValueError:
        found = []
    if len(found) != len(default) or not np.isfinite(found).all() or (name == "voxel_size" and min(found) <= 0):
        raise ConfigError(f"{path}: {name}: expected {len(default)} numbers, got {str(value)[:80]}")
    return found


def is_pillar_head(session: Any) -> bool:
    """Tell whether a network is the head of two files: it takes features by cell, and has six outputs."""
    ports = session.get_inputs()
    return len(ports) == 1 and len(ports[0].shape) == 4 and len(session.get_outputs()) == len(_OUTPUTS)


class PillarDetector:
    """Runs both networks, after a trial on one point, as headers don't tell everything. `name` is that of their
    parameters. Raises ConfigError where a file is missing, ModelError where they aren't such networks.
    """

    def __init__(
        self, head: Any, head_path: Path, encoder_path: Path, layout: PillarLayout, threads: int, name: str
    ) -> None:
        self._head, self._path, self._layout, self._name = head, head_path, layout, name
        try:
            self._encoder = load(encoder_path, threads)
        except ModelError as error:
            raise ModelError(f"{encoder_path}: {error}") from error
        ports = self._encoder.get_inputs()
        shape = ports[0].shape if len(ports) == 1 else []
        if len(shape) != 3 or not isinstance(shape[1], int) or shape[2] not in (9, 10):
            raise ModelError(
                f"{encoder_path}: not a voxel encoder of x, y, z and time: it takes {[p.shape for p in ports]}"
            )
        self._fixed, self._num_points, self._num_features = shape
        self._num_channels, rows, columns = head.get_inputs()[0].shape[1:]
        if any(isinstance(n, int) and n != own for n, own in zip((rows, columns), layout.shape, strict=True)):
            raise ModelError(
                f"{head_path}: takes {rows} x {columns} cells, but range and voxel size give "
                f"{layout.shape[0]} x {layout.shape[1]}; name its parameters by {name}.layout"
            )
        named = {port.name: port.name for port in head.get_outputs()}
        in_order = dict(zip(_OUTPUTS, named, strict=True))
        self._names = [named.get(name, in_order[name]) for name in _OUTPUTS]
        self.classes = tuple(label(name) for name in layout.classes)
        middle = (np.array([layout.low_m]) + np.array([layout.high_m])) / 2
        self.detect(BevPoints(middle.astype(np.float32), NO_RADAR), Plane(0.0, 0.0, 0.0), 1.0)

    def detect(self, points: BevPoints, plane: Plane, least: float) -> Boxes3D:
        """Find boxes with at least the score `least` in LiDAR points, in body coordinates, by falling score. Raises
        ModelError where a network fails.
        """
        features, cell = group_points(points.lidar, self._layout, self._num_points, self._num_features)
        if isinstance(self._fixed, int):  # of more pillars, the first count
            features, cell = features[: self._fixed], cell[: self._fixed]
        rows, columns = self._layout.shape
        try:
            found = np.reshape(self._run(self._encoder, self._fill(features))[0], (-1, self._num_channels))
            canvas = np.zeros((self._num_channels, rows * columns), np.float32)
            canvas[:, cell] = found[: len(cell)].T
            outputs = self._run(self._head, canvas.reshape(1, -1, rows, columns), self._names)
        except (*ORT_ERRORS, TypeError) as error:
            raise ModelError(f"{self._path}: the network failed ({first_line(error)})") from error
        self._check(outputs)
        return decode(outputs, self._layout, least, plane)

    def _check(self, outputs: Sequence[object]) -> None:
        """Refuse outputs that aren't as the layout says."""
        layout = self._layout
        inner = tuple(num // layout.stride for num in layout.shape)
        for (name, size), output in zip(_OUTPUTS.items(), outputs, strict=True):
            sizes = (size, 2 * size) if size else (len(layout.classes),)
            if not isinstance(output, np.ndarray) or output.shape not in [(1, num, *inner) for num in sizes]:
                shape = output.shape if isinstance(output, np.ndarray) else "none"
                raise ModelError(
                    f"{self._path}: not the output of such a network: '{name}' has the shape {shape} instead of "
                    f"{(1, sizes[0], *inner)}, which follows from {self._name}.layout"
                )
            if not np.isfinite(output).all():
                raise ModelError(f"{self._path}: not the output of such a network: '{name}' isn't finite")

    def _fill(self, features: Float32) -> Float32:
        """Add empty pillars where the encoder takes a fixed number."""
        if not isinstance(self._fixed, int):
            return features
        filled = np.zeros((self._fixed, *features.shape[1:]), np.float32)
        filled[: len(features)] = features
        return filled

    def _run(self, session: Any, values: Float32, names: Sequence[str] | None = None) -> list[Array]:
        return list(session.run(names, {session.get_inputs()[0].name: values}))


def group_points(points: Float32, layout: PillarLayout, num_points: int, num_features: int) -> tuple[Float32, Int64]:
    """Return the features (V, `num_points`, 9 or 10) of pillars that hold points (N, 3), and the cells (V,) they stand
    in, row by row along y. Features: x, y, z, time since the sweep (0), distances from the mean of the pillar's points,
    and from its middle along x, y, and, where there are ten, z; 0 where there are no more points.
    """
    low, high, size = (np.array(v, np.float32) for v in (layout.low_m, layout.high_m, layout.cell_m))
    rows, columns = layout.shape
    inside = points[((points >= low) & (points < high)).all(axis=1)]
    column, row = np.floor((inside[:, :2] - low[:2]) / size[:2]).astype(np.int64).T
    kept = (column < columns) & (row < rows)  # rounding may put the last ones beyond
    inside, cell = inside[kept], (row * columns + column)[kept]
    order = np.lexsort((inside[:, 2], inside[:, 1], inside[:, 0], cell))
    inside, cell = inside[order], cell[order]
    first = np.flatnonzero(np.diff(cell, prepend=-1))[:MAX_PILLARS]
    pillar = np.searchsorted(first, np.arange(len(cell)), side="right") - 1
    place = np.arange(len(cell)) - first[pillar] if len(cell) else pillar
    kept = (place < num_points) & (cell <= cell[first[-1]]) if len(cell) else np.zeros(0, bool)
    inside, pillar, place = inside[kept], pillar[kept], place[kept]
    taken = cell[first]
    middle = np.column_stack([taken % columns, taken // columns, 0 * taken]) * size + low + size / 2
    features = np.zeros((len(first), num_points, num_features), np.float32)
    features[pillar, place, :3] = inside
    features[pillar, place, 4:7] = inside - _means(inside, pillar, len(first))[pillar]
    features[pillar, place, 7:] = (inside - middle.astype(np.float32)[pillar])[:, : num_features - 7]
    return features, taken


def _means(points: Float32, group: Int64, num: int) -> Float32:
    count = np.maximum(np.bincount(group, minlength=num), 1)
    sums = [np.bincount(group, points[:, k], num) for k in range(3)]
    return (np.column_stack(sums) / count[:, None]).astype(np.float32)


def decode(outputs: Sequence[Array], layout: PillarLayout, least: float, plane: Plane) -> Boxes3D:
    """Turn the head's outputs (1, C, H, W), in the order of `_OUTPUTS`, into labeled boxes by falling score. Rows run
    along y. Offsets are in cells from the cell's corner, sizes logarithms of width, length, height [m], headings sine
    and cosine of -yaw - pi/2, heights of the middle above `plane` [m].
    """
    heat, offset, height, size, turn, speed = (np.asarray(o[0], np.float64).reshape(o.shape[1], -1) for o in outputs)
    with np.errstate(over="ignore"):
        score = 1 / (1 + np.exp(-heat))
    kind, best = score.argmax(axis=0), score.max(axis=0)
    needs_turn = np.array([label(name) != "pedestrian" for name in layout.classes])[kind]
    rows = np.flatnonzero((best >= least) & ((np.hypot(turn[0], turn[1]) >= _LEAST_TURN) | ~needs_turn))
    rows = rows[np.argsort(-best[rows], kind="stable")[:_MAX_CANDIDATES]]
    row, column = np.divmod(rows, outputs[0].shape[3])
    step = np.array(layout.cell_m[:2]) * layout.stride
    place = np.column_stack([column + offset[0, rows], row + offset[1, rows]]) * step + np.array(layout.low_m[:2])
    width, length, tall = np.exp(np.clip(size[:3, rows], -_LARGEST, _LARGEST))
    center = np.column_stack([place, height[0, rows]])
    center[:, 2] += plane.z_m(center)
    velocity = np.column_stack([speed[0, rows], speed[1, rows], np.zeros(len(rows))])
    names = np.array([label(name) for name in layout.classes])
    heading = np.arctan2(turn[0, rows], turn[1, rows])
    boxes = Boxes3D(
        center, np.column_stack([length, width, tall]), wrap_angle(-heading - np.pi / 2),
        velocity_mps=velocity if layout.has_velocity else None, label=names[kind[rows]], score=best[rows],
    )  # fmt: skip
    apart = boxes.center_m[:, None, :2] - boxes.center_m[None, :, :2]
    boxes = boxes[suppress((apart * apart).sum(axis=2) < _APART_M**2)[:_MAX_BOXES]]
    return boxes[suppress(iou_bev(boxes, boxes) > _MAX_IOU)]
