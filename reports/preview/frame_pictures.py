"""All pictures of one frame."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.data import Kind
from fbench.replay.errors import LogError
from fbench.replay.images import Pixels
from fbench.reports.preview import camera, views
from fbench.reports.preview.album import Album
from fbench.reports.preview.content import Shown
from fbench.reports.preview.layers import boxes3d, rectangles
from fbench.reports.preview.sample import Sample
from fbench.reports.preview.views import Ground

_NAMES: dict[Kind, str] = {"lidar": "LiDAR", "radar": "radar", "camera": "camera"}
_POINTS: tuple[Kind, ...] = ("lidar", "radar")
_KINDS: dict[str, Kind] = {kind: kind for kind in _POINTS}


@dataclass(frozen=True, eq=False)
class FramePictures:
    """Draws one frame after the other."""

    album: Album
    ground: Ground
    lidars: Sequence[str]
    """All LiDARs, for their colours."""

    def of(self, sample: Sample) -> Iterator[Shown]:
        """Draw every camera, and points from above and from the side."""
        for name in sample.cameras:
            yield from self._camera(sample, name)
        if sample.placed("lidar") or sample.placed("radar") or len(boxes3d(sample.truth)):
            yield from self._views(sample)
        for points in sample.points:
            if not points.is_placed:
                stem = f"{sample.frame.index:06d}-{self.album.stem(points.sensor)}-own"
                caption = f"{points.sensor} in its own coordinates, since its place isn't known."
                yield self.album.add(stem, views.from_own(points), caption, f"Points of {points.sensor}")

    def _camera(self, sample: Sample, name: str) -> Iterator[Shown]:
        stem = f"{sample.frame.index:06d}-{self.album.stem(name)}"
        kinds = [kind for kind in _POINTS if sample.placed(kind)]
        is_placed = name in sample.rig.mounts and name in sample.rig.cameras
        if not is_placed or not (kinds or len(boxes3d(sample.truth))):
            yield self._bare(sample, name, stem)
            return
        try:
            for kind in kinds or _POINTS[:1]:
                what = f"{_NAMES[kind]} in {name}"
                text = f"{what}. {_ages(sample, name, kind)}{_truth(sample, name)}"
                yield self.album.add(f"{stem}-{kind}", camera.overlay(sample, name, kind), text, what)
            zooms = [z for kind in kinds if (z := camera.zoom(sample, name, kind)) is not None]
        except LogError as error:
            yield self._bare(sample, name, stem, f" {error}.")
            return
        if zooms:
            text = "A closer look at the nearest truth, or else at the densest points."
            yield self.album.add(f"{stem}-zoom", _side_by_side(zooms), text, f"Part of {name}, enlarged")

    def _bare(self, sample: Sample, name: str, stem: str, why: str = "") -> Shown:
        text = f"{name} as recorded. {_ages(sample, name)}{_truth(sample, name)}{why}"
        return self.album.add(stem, camera.bare(sample, name), text, f"Image of {name}")

    def _views(self, sample: Sample) -> Iterator[Shown]:
        ages = _ages(sample, *sorted(p.sensor for p in sample.points if p.is_placed))
        boxes = len(boxes3d(sample.truth))
        text = f"From above, body coordinates, x forward is up. {ages}{f' {boxes} boxes of truth.' if boxes else ''}"
        index = sample.frame.index
        above = views.from_above(sample, self.ground, self.lidars)
        yield self.album.add(f"{index:06d}-above", above, text, "Points and truth from above")
        side = views.from_side(sample, self.ground, self.lidars)
        text = "From the side: a tilted or misplaced sensor lifts or sinks the ground with distance."
        yield self.album.add(f"{index:06d}-side", side, text, "Points and truth from the side")


def _ages(sample: Sample, *names: str) -> str:
    """How far the messages are from the instant; kinds stand for all their sensors."""
    wanted = [sensor for name in names for sensor in _sensors(sample, name)]
    ages = [(sensor, sample.age_ms(sensor)) for sensor in dict.fromkeys(wanted)]
    told = ", ".join(f"{sensor} {age:+.1f} ms" for sensor, age in ages if age is not None)
    return f"Measured after the frame's instant: {told}." if told else ""


def _sensors(sample: Sample, name: str) -> list[str]:
    kind = _KINDS.get(name)
    return [name] if kind is None else [points.sensor for points in sample.placed(kind)]


def _truth(sample: Sample, name: str) -> str:
    flat = len(rectangles(sample.truth, name))
    full = len(boxes3d(sample.truth))
    if sample.truth is None:
        return " No truth in this frame."
    told = [f"{full} in 3D (green)"] * (full > 0) + [f"{flat} in this image (cyan)"] * (flat > 0)
    return f" Truth: {', '.join(told) or 'no boxes'}."


def _side_by_side(pictures: Sequence[Pixels]) -> Pixels:
    height = max(p.shape[0] for p in pictures)
    padded = [np.pad(p, ((0, height - p.shape[0]), (0, 0), (0, 0))) for p in pictures]
    return np.concatenate(padded, axis=1)
