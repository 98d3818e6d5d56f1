"""A contact sheet: one frame of a scene, pipelines as rows and conditions as columns (thesis, figures 9.1 to 9.4).

Pipelines that find boxes in images get the camera's view, others a view from above. Drawn by matplotlib (extra
`figures`); equal runs give equal bytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array, Bool, Float64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D, Source, finite
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import not_projectable, project_boxes
from fbench.replay.geometry.iou import corners
from fbench.replay.runs.folder import Run
from fbench.replay.runs.media import MediaFrame
from fbench.reports.figures import FORMS, shorten, style
from fbench.reports.preview.draw import of_speed
from fbench.reports.tables import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Color = tuple[float, float, float]
_CELL_IN = (1.6, 1.2)  # Of a cell, 320 x 240 px in PNG
_AHEAD_M, _ASIDE_M = (-10.0, 70.0), 30.0  # What is seen from above: x to the right, y up
_SCALE = 4  # Pixels per meter, of the points from above
_DARK = "#0d1014"
_TRUTH = "#cfd3d6"
_FOOTPRINT = [0, 2, 3, 1, 0]  # Corners of a box around its foot
_COLORS: Mapping[int, Color] = {Source.C: (0.95, 0.2, 0.2), Source.L: (0.2, 0.85, 0.3), Source.R: (0.3, 0.5, 1.0)}
_STEREO: Color = (1.0, 0.6, 0.1)
_UNKNOWN: Color = (0.65, 0.65, 0.65)


@dataclass(frozen=True, eq=False)
class Cell:
    """What one pipeline found under one condition."""

    run: Run
    media: MediaFrame | None  # `None`: there are no pictures of the frame


@dataclass(frozen=True, eq=False)
class Sheet:
    """One frame of all cells."""

    title: str
    index: int
    rows: Sequence[str]  # Pipelines
    columns: Sequence[str]  # Conditions
    cells: Mapping[tuple[str, str], Cell]  # By row and column


@dataclass(frozen=True, eq=False)
class Shown:
    """What a cell shows of its frame."""

    found: Boxes
    num_truth: int | None  # `None`: not labeled


def of_sources(mask: int) -> Color:
    """Return the color of who contributed: camera red, LiDAR green, radar blue, as in the thesis; their sum where
    several did; stereo orange where it is alone, and gray where nobody knows.
    """
    own = [color for source, color in _COLORS.items() if mask & source]
    if not own:
        return _STEREO if mask & Source.S else _UNKNOWN
    r, g, b = (min(1.0, sum(color[i] for color in own)) for i in range(3))
    return r, g, b


def require_drawable(out: Path) -> str:
    """Return the form of a sheet. Raises ConfigError where there is no such form; MissingPackageError without
    matplotlib.
    """
    form = out.suffix.removeprefix(".").lower()
    if form not in FORMS:
        raise ConfigError(f"--sheet {out}: expected a name that ends in .png or .svg")
    with style("--sheet"):
        return form


def draw_sheet(sheet: Sheet, out: Path) -> None:
    """Write a sheet as `FILE.png` or `FILE.svg`. Raises ConfigError where the name ends otherwise or can't be written;
    MissingPackageError without matplotlib.
    """
    form = require_drawable(out)
    with style("--sheet") as new_figure:
        figure = new_figure()
        _draw(sheet, figure)
        write_whole(out, partial(figure.savefig, format=form, metadata=dict(FORMS[form])))


def _draw(sheet: Sheet, figure: "Figure") -> None:
    from matplotlib.lines import Line2D

    num_rows, num_columns = len(sheet.rows), len(sheet.columns)
    figure.set_size_inches(_CELL_IN[0] * num_columns + 0.9, _CELL_IN[1] * num_rows + 0.9)
    masks: set[int] = set()
    for number, (row, column) in enumerate(((r, c) for r in sheet.rows for c in sheet.columns), 1):
        axes = figure.add_subplot(num_rows, num_columns, number)
        axes.set(xticks=[], yticks=[], facecolor=_DARK)
        axes.grid(visible=False)
        if number <= num_columns:
            text, size = _fit(column, _CELL_IN[0])
            axes.set_title(text, fontsize=size)
        if (number - 1) % num_columns == 0:
            text, size = _fit(row, _CELL_IN[1])
            axes.set_ylabel(text, fontsize=size)
        cell = sheet.cells.get((row, column))
        if cell is None or all(frame.index != sheet.index for frame in cell.run.frames):
            reason = "no run" if cell is None else f"no frame {sheet.index}"
            axes.text(0.5, 0.5, reason, color=_TRUTH, ha="center", va="center", transform=axes.transAxes)
            continue
        boxes = cell.run.detections.at(sheet.index)
        shown = (_draw_image if isinstance(boxes, Boxes2D) else _draw_from_above)(axes, cell, boxes, sheet.index)
        masks |= set(_masks(shown.found).tolist())
        text = f"{len(shown.found)} found" + ("" if shown.num_truth is None else f", {shown.num_truth} true")
        axes.text(0.02, 0.03, text, color="white", fontsize=6, transform=axes.transAxes)
    figure.suptitle(shorten(sheet.title, 90), fontsize=9)
    lines = [Line2D([], [], color=of_sources(mask), label=_name(mask)) for mask in sorted(masks)]
    lines.append(Line2D([], [], color=_TRUTH, lw=0.8, ls=(0, (3, 1)), label="truth"))
    num_entries = min(len(lines), int(figure.get_figwidth()))  # beside each other; one needs about an inch
    legend = figure.legend(handles=lines, loc="outside lower center", ncols=num_entries)
    legend.get_frame().set(facecolor=_DARK, alpha=1.0)
    legend.set_frame_on(True)
    for label in legend.get_texts():
        label.set_color("white")


def _fit(text: str, room_in: float) -> tuple[str, float]:
    """Shorten a label of a cell, and return how large it may be [pt]: its characters are about 0.65 as wide."""
    room = 0.9 * 72 * room_in / 0.65
    label = shorten(text, int(room / 5))
    return label, min(8.0, room / len(label))


def _name(mask: int) -> str:
    return "+".join(str(source.name) for source in Source if mask & source) or "sources unknown"


def _masks(boxes: Boxes) -> Array:
    return np.zeros(len(boxes), np.uint8) if boxes.sources is None else boxes.sources


def _draw_image(axes: "Axes", cell: Cell, found: Boxes, index: int) -> Shown:
    """Draw truth and detections into the picture of the first camera that has one."""
    manifest, pictures = cell.run.manifest, {} if cell.media is None else cell.media.pictures
    frame = next(frame for frame in cell.run.frames if frame.index == index)
    rig = manifest.rig_of(frame.segment)
    sizes = {**manifest.images, **{name: camera.size_wh for name, camera in sorted(rig.cameras.items())}}
    named = [name for name in sorted(sizes) if name in pictures] or sorted(sizes)
    assert isinstance(found, Boxes2D)  # noqa: S101  # the caller looked
    camera = named[0] if named else next(iter(found.camera), "")
    width, height = sizes.get(camera, (800, 600))
    if camera in pictures:
        pixels = cv2.imdecode(np.frombuffer(pictures[camera].jpeg, np.uint8), cv2.IMREAD_COLOR)
        small = cv2.resize(pixels, (640, round(640 * height / width)), interpolation=cv2.INTER_AREA)
        axes.imshow(small[:, :, ::-1], extent=(-0.5, width - 0.5, height - 0.5, -0.5), aspect="auto")
    truth = _truth_px(cell.run, rig, camera, index)
    if truth is not None:
        _outline(axes, [_rectangle(box) for box in truth], [_TRUTH] * len(truth), 0.6, dashed=True)
    own = found[finite(found)[0] & (found.camera == camera)]
    _outline(axes, [_rectangle(box) for box in own.xyxy_px], [of_sources(int(mask)) for mask in _masks(own)], 1.1)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    return Shown(own, None if truth is None else len(truth))


def _truth_px(run: Run, rig: Rig, camera: str, index: int) -> Float64 | None:
    """Rectangles (N, 4) of the truth that counts in an image: recorded there, else projected; `None` where neither."""
    in_image, in_space = run.truth2d(index), run.truth3d(index)
    if in_image is not None:
        return in_image[_counts(in_image) & (in_image.camera == camera)].xyxy_px
    if in_space is None or camera not in rig.cameras or not_projectable(rig.cameras[camera]) is not None:
        return None
    rectangles, seen = project_boxes(rig, camera, in_space[_counts(in_space)])
    return rectangles[seen]


def _counts(boxes: Boxes) -> Bool:
    kept = finite(boxes)[0]
    return kept if boxes.ignore is None else kept & ~boxes.ignore


def _draw_from_above(axes: "Axes", cell: Cell, found: Boxes, index: int) -> Shown:
    """Draw points, truth and detections from above: x ahead is to the right."""
    if cell.media is not None:
        extent = (*_AHEAD_M, -_ASIDE_M, _ASIDE_M)
        axes.imshow(_points(cell.media)[:, :, ::-1], extent=extent, aspect="auto", interpolation="none")
    truth = cell.run.truth3d(index)
    if truth is not None:
        truth = truth[_counts(truth) & _in_view(truth)]
        _outline(axes, list(corners(truth)[:, _FOOTPRINT, :2]), [_TRUTH] * len(truth), 0.6, dashed=True)
    assert isinstance(found, Boxes3D)  # noqa: S101  # there are no others
    own = found[finite(found)[0] & _in_view(found)]
    colors = [of_sources(int(mask)) for mask in _masks(own)]
    _outline(axes, list(corners(own)[:, _FOOTPRINT, :2]), colors, 1.1)
    axes.plot([0, 3, 0, 0], [1, 0, -1, 1], color="white", lw=0.8)
    axes.set(xlim=_AHEAD_M, ylim=(-_ASIDE_M, _ASIDE_M))
    return Shown(own, None if truth is None else len(truth))


def _in_view(boxes: Boxes3D) -> Bool:
    x, y = boxes.center_m[:, 0], boxes.center_m[:, 1]
    return np.asarray((x > _AHEAD_M[0]) & (x < _AHEAD_M[1]) & (np.abs(y) < _ASIDE_M), np.bool_)


def _points(media: MediaFrame) -> Pixels:
    """Points of all sensors from above; those of radars by speed."""
    width, height = round((_AHEAD_M[1] - _AHEAD_M[0]) * _SCALE), round(2 * _ASIDE_M * _SCALE)
    picture = np.full((height, width, 3), (20, 16, 13), np.uint8)
    found = [(bool(np.isfinite(points.speed_mps).any()), points) for _, points in sorted(media.points.items())]
    for is_radar, points in sorted(found, key=lambda pair: pair[0]):  # which are few, and drawn last
        colors = (
            of_speed(np.asarray(points.speed_mps, np.float64)) if is_radar else np.array([[110, 104, 98]], np.uint8)
        )
        u = np.floor((points.xyz[:, 0] - _AHEAD_M[0]) * _SCALE).astype(np.int64)
        v = np.floor((_ASIDE_M - points.xyz[:, 1]) * _SCALE).astype(np.int64)
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        picture[v[inside], u[inside]] = colors[inside] if is_radar else colors
    return picture


def _rectangle(box: Float64) -> Float64:
    return box[[0, 1, 2, 1, 2, 3, 0, 3, 0, 1]].reshape(5, 2)


def _outline(
    axes: "Axes", lines: Sequence[Float64], colors: Sequence[Color | str], width: float, dashed: bool = False
) -> None:
    from matplotlib.collections import LineCollection

    how = (0, (3, 1)) if dashed else "-"
    axes.add_collection(LineCollection(list(lines), colors=list(colors), linewidths=width, linestyles=how))
