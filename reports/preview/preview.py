"""The preview: pictures, verdicts, and the contact sheet that shows them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from markupsafe import Markup

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import KINDS, Kind
from fbench.replay.data.scores import format_count
from fbench.replay.geometry.stereo_pairs import pairs
from fbench.replay.geometry.transforms import yaw_pitch_roll
from fbench.reports.html.records import environment, resource
from fbench.reports.preview import camera, views
from fbench.reports.preview.camera import boxes3d, rectangles
from fbench.reports.preview.collect import Album, Content, FrameContent, SensorRow, Shown
from fbench.reports.preview.measure import Measured
from fbench.reports.preview.sample import Material, Sample
from fbench.reports.preview.times import SensorTimes, sensor_times
from fbench.reports.preview.views import Ground, ground_of

_PACKAGE = "fbench.reports.preview"
SHEET = "index.html"
_NAMES: dict[str, str] = {"lidar": "LiDAR", "radar": "radar", "camera": "camera"}
_POINTS: tuple[Kind, ...] = ("lidar", "radar")


@dataclass(frozen=True, eq=False)
class FramePictures:
    """Draws one frame after the other."""

    album: Album
    ground: Ground
    lidars: Sequence[str]  # All LiDARs, for their colors

    def of(self, sample: Sample) -> Iterator[Shown]:
        """Draw every camera, and points from above and from the side."""
        for name in sample.cameras:
            yield from self._camera(sample, name)
        if sample.points_of("lidar") or sample.points_of("radar") or len(boxes3d(sample.truth)):
            yield from self._views(sample)
        for points in sample.points:
            if not points.is_placed:
                stem = f"{sample.frame.index:06d}-{self.album.stem(points.sensor)}-own"
                caption = f"{points.sensor} in its own coordinates, since its place isn't known."
                yield self.album.add(stem, views.from_own(points), caption, f"Points of {points.sensor}")

    def _camera(self, sample: Sample, name: str) -> Iterator[Shown]:
        stem = f"{sample.frame.index:06d}-{self.album.stem(name)}"
        kinds = [kind for kind in _POINTS if sample.points_of(kind)]
        is_placed = name in sample.rig.mounts and name in sample.rig.cameras
        if not is_placed or not (kinds or len(boxes3d(sample.truth))):
            yield self._bare(sample, name, stem)
            return
        try:
            for kind in kinds or _POINTS[:1]:
                what = f"{_NAMES[kind]} in {name}"
                ages = _ages(sample, [name, *(points.sensor for points in sample.points_of(kind))])
                text = f"{what}. {ages}{_truth(sample, name)}"
                yield self.album.add(f"{stem}-{kind}", camera.overlay(sample, name, kind), text, what)
            zooms = [z for kind in kinds if (z := camera.zoom(sample, name, kind)) is not None]
        except LogError as error:
            yield self._bare(sample, name, stem, f" {error}.")
            return
        if zooms:
            text = "A closer look at the nearest truth, or else at the densest points."
            height = max(z.shape[0] for z in zooms)
            both = np.concatenate([np.pad(z, ((0, height - z.shape[0]), (0, 0), (0, 0))) for z in zooms], axis=1)
            yield self.album.add(f"{stem}-zoom", both, text, f"Part of {name}, enlarged")

    def _bare(self, sample: Sample, name: str, stem: str, why: str = "") -> Shown:
        text = f"{name} as recorded. {_ages(sample, [name])}{_truth(sample, name)}{why}"
        return self.album.add(stem, camera.bare(sample, name), text, f"Image of {name}")

    def _views(self, sample: Sample) -> Iterator[Shown]:
        ages = _ages(sample, sorted(p.sensor for p in sample.points if p.is_placed))
        boxes = len(boxes3d(sample.truth))
        truth = f" {format_count(boxes, 'box', 'boxes')} of truth." if boxes else ""
        text = f"From above, body coordinates, x forward is up. {ages}{truth}"
        index = sample.frame.index
        above = views.from_above(sample, self.ground, self.lidars)
        yield self.album.add(f"{index:06d}-above", above, text, "Points and truth from above")
        side = views.from_side(sample, self.ground, self.lidars)
        text = "From the side: a tilted or misplaced sensor lifts or sinks the ground with distance."
        yield self.album.add(f"{index:06d}-side", side, text, "Points and truth from the side")


def _ages(sample: Sample, names: Sequence[str]) -> str:
    """How far the messages of sensors are from the instant."""
    ages = [(sensor, sample.age_ms(sensor)) for sensor in dict.fromkeys(names)]
    texts = ", ".join(f"{sensor} {age:+.1f} ms" for sensor, age in ages if age is not None)
    return f"Measured after the frame's instant: {texts}." if texts else ""


def _truth(sample: Sample, name: str) -> str:
    if sample.truth is None:
        return " No truth in this frame."
    full, flat = len(boxes3d(sample.truth)), len(rectangles(sample.truth, name))
    texts = [f"{full} in 3D (green)"] * (full > 0) + [f"{flat} in this image (cyan)"] * (flat > 0)
    return f" Truth: {', '.join(texts) or 'no boxes'}."


class _Pages(Album):
    """Keeps pictures instead of writing them."""

    def __init__(self, album: Album) -> None:
        self.stem, self.kept = album.stem, dict[str, tuple[Pixels, str, str]]()  # type: ignore[method-assign]

    def add(self, stem: str, pixels: Pixels, caption: str, alt: str) -> Shown:
        self.kept[stem] = (pixels, caption, alt)
        return Shown(stem, (pixels.shape[1], pixels.shape[0]), caption, alt)


def _draw_pairs(draw: FramePictures, before: Sample, after: Sample) -> Iterator[Shown]:
    """Draw a frame as recorded and under conditions, side by side; gray where only one of both has a picture."""
    pages = [_Pages(draw.album), _Pages(draw.album)]
    for page, sample in zip(pages, (before, after), strict=True):
        for _ in replace(draw, album=page).of(sample):
            pass
    for stem in dict.fromkeys([*pages[0].kept, *pages[1].kept]):
        found = [page.kept.get(stem) for page in pages]
        pictures = [pixels for pixels, _, _ in filter(None, found)]
        height, width = (max(picture.shape[axis] for picture in pictures) for axis in (0, 1))
        halves = [np.full((height, width, 3), 128, np.uint8) for _ in found]
        for half, one in zip(halves, found, strict=True):
            if one is not None:
                half[: one[0].shape[0], : one[0].shape[1]] = one[0]
        _, caption, alt = next(filter(None, found))
        both = np.concatenate([halves[0], np.full((height, 4, 3), 255, np.uint8), halves[1]], axis=1)
        yield draw.album.add(stem, both, f"Left as recorded, right under conditions. {caption}", alt)


def write_preview(material: Material, folder: Path, disturbed: Material | None = None, conditions: str = "") -> Content:
    """Write `index.html` and the pictures that it shows into an existing folder; equal bytes for equal material. Frames
    are drawn beside those of the same log, `disturbed` by `conditions`, where it is given; verdicts are about the log
    as recorded.
    """
    names = sorted({*material.kinds, *material.num_messages})
    album = Album(folder, names)
    times = sensor_times(material)
    measured = Measured(material, album, gaps=list(_gaps(material)))
    measured.times(times)
    measured.mounting()
    measured.doppler()
    measured.labels()
    measured.alignment()
    stereo = measured.stereo()
    draw = FramePictures(album, ground_of(material.samples), [n for n in names if material.kinds.get(n) == "lidar"])
    frames = []
    others = {s.frame.index: s for s in disturbed.samples} if disturbed is not None else {}
    for s in material.samples:
        missing = "; ".join(f"{name}: {why}" for name, why in sorted(s.frame.missing.items()))
        head = f"at {s.frame.stamp_ns} ns{f' · missing: {missing}' if missing else ''}"
        other = others.get(s.frame.index)
        pictures = draw.of(s) if other is None else _draw_pairs(draw, s, other)
        frames.append(FrameContent(s.frame.index, head, [*pictures, *stereo.get(s.frame.index, [])]))
    rows = [_row(material, t) for t in times]
    verdicts = sorted(measured.verdicts, key=lambda v: not v.is_bad)
    facts = [
        ("Frames shown", f"{len(material.samples)} of {material.num_frames}"),
        ("Instants by", material.reference),
        ("With truth", f"{material.num_labeled} of {material.num_frames}"),
        ("Log id", material.info.log_id),
        *([("Conditions", conditions)] if conditions else []),
        *([(f"Changed of {name}", text) for name, text in disturbed.effects.items()] if disturbed is not None else []),
    ]
    content = Content(material.info.name, facts, rows, verdicts, measured.gaps, measured.shown, frames)
    style = resource("fbench.reports.html", "style.css") + resource(_PACKAGE, "sheet.css")
    page = environment(_PACKAGE).get_template("sheet.html").render(content=content, style=Markup(style))  # noqa: S704
    (folder / SHEET).write_text(page, "utf-8")
    return content


def _gaps(material: Material) -> Sequence[str]:
    """Say what isn't there."""
    gaps = [f"the log has no {_NAMES[kind]}" for kind in KINDS if kind not in material.kinds.values()]
    gaps += [f"{why}: it is shown on its own" for _, why in sorted(material.problems.items())]
    gaps += [f"{name} has very many points: every {n}. is shown" for name, n in material.strides.items()]
    gaps += [] if material.num_labeled else ["no frame has truth"]
    if sum(kind == "camera" for kind in material.kinds.values()) > 1 and not pairs(material.rig):
        gaps.append("no two cameras are a stereo pair (one size, parallel within 10 deg, 0.05 to 2 m side by side)")
    world = [s for s in material.samples if s.truth is not None and s.truth.in_world and s.truth.boxes3d is not None]
    return [*gaps, *(["3D truth is in world coordinates and isn't drawn"] if world else [])]


def _row(material: Material, times: SensorTimes) -> SensorRow:
    name, mounted, lens = times.sensor, "", ""
    missing = f"{times.num_missing} of {material.num_frames}: {times.reasons}" if times.num_missing else "0"
    if (mount := material.rig.mounts.get(name)) is not None:
        angles = ", ".join(f"{np.degrees(a) + 0.0:.2f}" for a in yaw_pitch_roll(mount.rotation_xyzw))
        place = ", ".join(f"{value + 0.0:.3f}" for value in mount.translation_m)
        mounted = f"{place} m; yaw, pitch, roll {angles}°"
    if (model := material.rig.cameras.get(name)) is not None:
        width, height = model.size_wh
        distortion = model.distortion_model if np.any(model.distortion) else "no distortion"
        lens = f"{width} × {height} px, f {model.K[0, 0]:.0f} px, {distortion}"
    shift, delay = (
        "–" if values is None else f"{values[0]:+.1f} ({values[1]:+.1f} to {values[2]:+.1f})"
        for values in (times.shift_ms, times.delay_ms)
    )
    kind, problem = material.kinds.get(name, "pose"), material.problems.get(name, "")
    return SensorRow(name, kind, times.num_messages, missing, mounted, lens, shift, delay, problem)
