"""The frames of all runs for the player: pictures, points and boxes in a budget, compressed, errors first."""

import zlib
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any, Literal

import numpy as np

from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.details import load_details
from fbench.replay.data.rig import Rig
from fbench.replay.runs.folder import Run
from fbench.replay.runs.media import MediaFrame
from fbench.replay.runs.outcomes import load_outcomes
from fbench.replay.runs.tables import BoxTable
from fbench.reports.boxes import box_rows
from fbench.reports.html.overview import current_rows, row_numbers, timeline
from fbench.reports.html.store import Store, compact_boxes, deflate_json, pack_cloud

PLAYER = (
    "store.js", "view.js", "points.js", "scene.js", "camera.js", "objects.js", "timeline.js", "errors.js", "player.js",
    "main.js",
)  # fmt: skip
"""Scripts of the player, in their order, after `base.js`."""
BUDGET_MB = 25.0
MAX_POINTS = (20_000, 6_000, 2_500)  # Of one cloud; fewer only where the budget leaves no room for more
MAX_FRAMES = 4_000  # Of all runs together; a browser holds no more boxes at ease
CHUNK = 16  # Frames that are compressed together
_AROUND = 5  # Frames before and after an error that come with it
_LONGEST = 60  # Frames of a clip
_BOX_SHARE = 0.6  # Of the budget, which boxes may take; pictures and points have the rest
_RANK = ("hit", "missed", "false alarm", "invalid", "ignored")


@dataclass(frozen=True)
class Clip:
    """A stretch of frames in which something changed, shown in several runs in step, with a mark on what changed."""

    title: str
    runs: tuple[int, ...]  # Their places among the runs of the page
    frames: tuple[int, int]  # Index of the first and the last frame
    marked: tuple[int, ...]  # Those among the runs in which it can be marked
    kind: Literal["truth", "detections", "tracks"]
    track_id: int | None = None
    xy_m: tuple[float, float] | None = None  # Where it is in the first of the frames, in body coordinates


@dataclass(frozen=True)
class Scenes:
    """What the player shows: `content` for the page's data, and the `store` that it refers to."""

    content: dict[str, Any]
    store: Store

    @property
    def num_shown(self) -> int:
        """Frames of all runs that can be looked at."""
        return sum(len(run["frames"]) for run in self.content["runs"])

    @property
    def num_left_out(self) -> int:
        """Frames of all runs that the budget left out."""
        return sum(len(run["timeline"]["t"]) for run in self.content["runs"]) - self.num_shown

    @property
    def num_without_media(self) -> int:
        """Frames whose kept pictures and points the budget left out."""
        return int(sum(run["without_media"] for run in self.content["runs"]))


def scenes(
    runs: Sequence[Run], labels: Sequence[str], budget_bytes: float = BUDGET_MB * 1e6, clips: Sequence[Clip] = ()
) -> Scenes:
    """Return timelines and frames of all runs, as many as fit into a budget: first the frames with most errors, each
    with a stretch around it, and then the others, evenly. With `clips`, only their frames, those of the first clips
    first.

    Pictures are JPEG. Points are little-endian int16, raw deflate, all x, then y and z [cm] in body coordinates, then
    radial velocities [cm/s], -32768 where unknown. Boxes are JSON, raw deflate, `CHUNK` frames together.
    """
    shown = [_Shown(run, label) for run, label in zip(runs, labels, strict=True)]
    starts = {s.log: min(o.start_ns for o in shown if o.log == s.log) for s in shown}
    logs = list(starts)
    boxes, share = Store(), 1.0
    most = max(50, MAX_FRAMES // max(1, len(runs)))
    truths: dict[object, Any] = {}
    for number, one in enumerate(shown):
        one.choose(most, [clip.frames for clip in clips if number in clip.runs] if clips else None)
        one.describe(truths)
    while True:
        content = [one.write_boxes(boxes, int(np.ceil(share * one.num))) for one in shown]
        if boxes.num_bytes <= _BOX_SHARE * budget_bytes or share == 0.0:
            break
        share = 0.0 if share < 1e-3 else share * min(0.9, _BOX_SHARE * budget_bytes / boxes.num_bytes)
        boxes = Store()
    store = boxes
    for max_points in MAX_POINTS:
        store = Store(dict(boxes.entries))
        if _add_media(shown, content, store, max_points, budget_bytes):
            break
    for one, entry in zip(shown, content, strict=True):
        entry |= {"log": logs.index(one.log), "start": (one.start_ns - starts[one.log]) / 1e9}
    names = sorted({label for one in shown for label in one.labels})
    sources = sorted({bits for one in shown for bits in one.sources})
    page: dict[str, Any] = {"runs": content, "chunk": CHUNK, "labels": names, "sources": sources}
    page["clips"] = [_describe_clip(clip, shown[clip.runs[0]]) for clip in clips]
    return Scenes(page, store)


def _describe_clip(clip: Clip, first: "_Shown") -> dict[str, Any]:
    """Describe a clip for the page: `rows` of its first run, and how many frames `lead` to what it is about."""
    rows = first.rows_of(clip.frames)
    lead = sum(first.run.frames[row].index < clip.frames[0] for row in rows)
    mark = {"kind": clip.kind, "id": clip.track_id, "xy": clip.xy_m, "runs": clip.marked}
    ends = [rows[0], rows[-1]] if rows else [0, 0]
    return {"title": clip.title, "runs": clip.runs, "rows": ends, "lead": lead, "mark": mark}


def _add_media(
    shown: Sequence["_Shown"], content: Sequence[dict[str, Any]], store: Store, max_points: int, budget: float
) -> bool:
    """Add pictures and points, those of the worst frames first, the runs in turn. Returns whether all fit."""
    for entry in content:
        entry |= {"media": [], "without_media": 0}
    queues = [one.media_by_rank({*entry["frames"]}) for one, entry in zip(shown, content, strict=True)]
    used, is_whole = store.num_bytes, True
    packed: dict[bytes, bytes] = {}
    for turn in range(max(map(len, queues), default=0)):
        for queue, entry in zip(queues, content, strict=True):
            if turn >= len(queue):
                continue
            row, kept, rig = queue[turn]
            pictures = {name: picture.jpeg for name, picture in sorted(kept.pictures.items())}
            clouds = {name: pack_cloud(points, max_points, packed) for name, points in sorted(kept.points.items())}
            size = store.cost([*pictures.values(), *clouds.values()])
            if used + size > budget:
                entry["without_media"] += 1
                is_whole = False
                continue
            used += size
            points = [
                {"sensor": name, "kind": rig.mounts[name].kind if name in rig.mounts else "lidar",
                 "cloud": store.add(data)} for name, data in clouds.items()
            ]  # fmt: skip
            numbers = {name: store.add(data) for name, data in pictures.items()}
            entry["media"].append([row, {"pictures": numbers, "clouds": points}])
    for entry in content:
        entry["media"].sort(key=lambda item: item[0])
    return is_whole


class _Shown:
    """One run in the player."""

    def __init__(self, run: Run, label: str) -> None:
        self.run, self.label = run, label
        self.outcomes = {name: _best(found) for name, found in load_outcomes(run.folder).items()}
        self.is_flat = bool(self.outcomes.get("truth_2d"))  # Whether truth in images is what counts
        self.rows, self.current = row_numbers(run), current_rows(run)
        self.start_ns = run.frames[0].stamp_ns if run.frames else 0
        self.log = run.manifest.data_key
        self.switched = self._find_switches()
        self.errors, self.timeline = self._count_errors(), timeline(run)
        self.order: list[int] = []
        self._boxes: dict[int, tuple[Any, Any]] = {}
        pictures = {name for kept in run.media for name in kept.pictures}
        self.cameras = pictures or {*run.manifest.rig.cameras}

    @property
    def labels(self) -> set[str]:
        """Classes that occur."""
        names = ("truth", "truth_2d", "detections", "tracks") if self.run.frames else ()
        tables = [self._table(name) for name in names]
        found = {str(label) for t in tables if t.boxes.label is not None for label in np.unique(t.boxes.label)}
        return found - {""}

    @property
    def sources(self) -> set[int]:
        """Combinations of sensors that occur."""
        tables = (self.run.detections, self.run.tracks) if self.run.frames else ()
        return {int(bits) for t in tables if t.boxes.sources is not None for bits in np.unique(t.boxes.sources)}

    @property
    def num(self) -> int:
        """Frames whose boxes are at hand."""
        return len(self.order)

    def _find_switches(self) -> dict[int, list[int]]:
        """Return the ids of the truth objects whose track changes, by the row of the frame."""
        found: dict[int, list[int]] = {}
        details = load_details(self.run.folder)
        for one in details.objects if details else ():
            spans = [span for span in one.spans if span.track_id is not None]
            for before, span in pairwise(spans):
                if before.track_id != span.track_id and span.first_frame in self.rows:
                    found.setdefault(self.rows[span.first_frame], []).append(one.track_id)
        return found

    def _count_errors(self) -> dict[str, Int64]:
        """Count what was missed, and false alarms of detections and tracks, in each frame (F,)."""
        counts = {}
        truth = "truth_2d" if self.is_flat else "truth"
        for kind, name in (("missed", truth), ("alarms", "detections"), ("false_tracks", "tracks")):
            wrong = "missed" if kind == "missed" else "false alarm"
            rows = [row for row, outcome in self.outcomes.get(name, {}).items() if outcome == wrong]
            frames = self._table(name).frames[rows].tolist() if rows else []
            number = [self.rows[index] for index in frames if index in self.rows]
            counts[kind] = np.bincount(np.array(number, np.int64), minlength=len(self.run.frames))
        ids = [self.switched.get(row, ()) for row in range(len(self.run.frames))]
        counts["switches"] = np.array([len(own) for own in ids], np.int64)
        return counts

    def _table(self, name: str) -> BoxTable:
        if name.startswith("truth"):
            return self.run.truth_table("2d" if name == "truth_2d" else "3d")
        return self.run.detections if name == "detections" else self.run.tracks

    def rank(self) -> list[int]:
        """Return rows of the frames, the worst and their neighbors first, the others evenly spread."""
        errors = np.sum([*self.errors.values()], axis=0).astype(np.float64)
        near = errors.copy()
        for step in range(1, _AROUND + 1):
            near[step:] = np.maximum(near[step:], errors[:-step] - 0.1 * step)
            near[:-step] = np.maximum(near[:-step], errors[step:] - 0.1 * step)
        bits = max(1, len(errors).bit_length())
        spread = [int(f"{row:0{bits}b}"[::-1], 2) for row in range(len(errors))]
        return sorted(range(len(errors)), key=lambda row: (-near[row], spread[row], row))

    def choose(self, most: int, stretches: Sequence[tuple[int, int]] | None) -> None:
        """Settle on `most` frames at most, in the order in which they are given up last: those around stretches from
        one frame index to another, or `None`: any.
        """
        wanted = self.rank() if stretches is None else [row for ends in stretches for row in self.rows_of(ends)]
        self.order = list(dict.fromkeys(wanted))[:most]

    def rows_of(self, frames: tuple[int, int]) -> list[int]:
        """Return the rows of a stretch of frames with some around it, not of all of a long one."""
        index = [frame.index for frame in self.run.frames]
        start, stop = bisect_left(index, frames[0]), bisect_right(index, frames[1])
        return list(range(max(0, start - _AROUND), min(len(index), stop + _AROUND)))[:_LONGEST]

    def media_by_rank(self, shown: set[int]) -> list[tuple[int, MediaFrame, Rig]]:
        """Return the shown frames whose pictures and points are kept, with their rigs, the worst first."""
        place = {row: at for at, row in enumerate(self.order)}
        kept = [(self.rows[one.index], one) for one in self.run.media if self.rows.get(one.index, -1) in shown]
        kept = sorted(kept, key=lambda item: place[item[0]])
        return [(row, one, self.run.manifest.rig_of(self.run.frames[row].segment)) for row, one in kept]

    def describe(self, truths: dict[object, Any]) -> None:
        """Describe the boxes of the chosen frames, those of one rig together; truth that several runs have once."""
        chosen = sorted(self.order)
        results: dict[int, Any] = {row: {} for row in chosen}
        for name in ("detections", "tracks"):
            # Of a frame that was dropped, the output that was the latest then.
            for row, boxes in self._compact(name, [(r, self.current[r]) for r in chosen], self.cameras):
                results[row][name] = boxes
        spaces = ("truth_2d",) if self.is_flat else ()
        truth: dict[int, list[Any]] = {row: [] for row in chosen}
        for name in ("truth", *spaces):
            cameras = frozenset[str]() if self.is_flat else frozenset(self.cameras)
            for row, boxes in self._truth(name, chosen, cameras, truths):
                truth[row] += boxes
        flat_only = [row for row in chosen if not self.is_flat and self.run.frames[row].truth_spaces == "2d"]
        for row, boxes in self._truth("truth_2d", flat_only, frozenset(), truths):
            truth[row] += boxes
        for row in chosen:
            frame, pose = self.run.frames[row], self.run.poses[row]
            results[row] |= {
                "switched": self.switched.get(row, []),
                "outcomes": self._outcomes_of_truth(row, len(truth[row])),
                "labelled": frame.truth_stamp_ns is not None,
                "cameras": _sizes(self.run.manifest.rig_of(frame.segment)),
                "pose": _flat_pose(pose) if np.isfinite(pose).all() else None,
            }
            self._boxes[row] = (truth[row], results[row])

    def _truth(
        self, name: str, chosen: list[int], cameras: frozenset[str], truths: dict[object, Any]
    ) -> Iterator[tuple[int, Any]]:
        kind = "2d" if name == "truth_2d" else "3d"
        rows = [row for row in chosen if kind in self.run.frames[row].truth_spaces.split()]
        if not rows:
            return
        table = self._table(name)
        place = table.boxes.xyxy_px if isinstance(table.boxes, Boxes2D) else table.boxes.center_m
        key = (name, cameras, tuple(rows), self.log, zlib.crc32(place.tobytes()), len(table.boxes))
        if key not in truths:
            truths[key] = [*self._compact(name, [(row, row) for row in rows], cameras, with_outcomes=False)]
        yield from truths[key]

    def _compact(
        self, name: str, pairs: list[tuple[int, int | None]], cameras: Any, *, with_outcomes: bool = True
    ) -> Iterator[tuple[int, list[Any]]]:
        """Yield the boxes of a table for each frame, by the row that shows them and the row that has them."""
        if not pairs:
            return
        table, outcomes = self._table(name), self.outcomes.get(name, {})
        frames = self.run.frames
        for segment, group in groupby(pairs, key=lambda pair: frames[pair[0]].segment):
            members = list(group)
            rig = self.run.manifest.rig_of(segment)
            seen = [name for name in sorted(cameras) if name in rig.cameras and name in rig.mounts]
            spans = []
            for _, source in members:
                index = -1 if source is None else frames[source].index
                start, stop = np.searchsorted(table.frames, [index, index + 1]).tolist()
                spans.append(range(start, stop) if source is not None else range(0))
            wanted = np.array([at for span in spans for at in span], np.int64)
            boxes = table.boxes[wanted]
            rows = iter(zip(wanted.tolist(), compact_boxes(boxes, box_rows(boxes, rig, seen)), strict=True))
            for (row, _), span in zip(members, spans, strict=True):
                found = []
                for _ in span:
                    at, box = next(rows)
                    if with_outcomes and at in outcomes:
                        box["outcome"] = outcomes[at]
                    found.append(box)
                yield row, found

    def _outcomes_of_truth(self, row: int, num: int) -> list[str]:
        """Return the outcomes of the truth boxes that a frame shows, in their order; empty ones at the end left out."""
        index, found = self.run.frames[row].index, []
        spaces = self.run.frames[row].truth_spaces.split()
        names = [name for name, space in (("truth", "3d"), ("truth_2d", "2d")) if space in spaces]
        for name in names if self.is_flat or names == ["truth_2d"] else names[:1]:
            start, stop = np.searchsorted(self._table(name).frames, [index, index + 1]).tolist()
            found += [self.outcomes.get(name, {}).get(at, "") for at in range(start, stop)]
        return found[:num] if any(found) else []

    def write_boxes(self, store: Store, num: int) -> dict[str, Any]:
        """Add the boxes of the first `num` frames to a store, and return what the page needs to find them."""
        rows = sorted(self.order[:num])
        chunks = []
        for start in range(0, len(rows), CHUNK):
            both = [self._boxes[row] for row in rows[start : start + CHUNK]]
            chunks.append([store.add(deflate_json([pair[side] for pair in both])) for side in (0, 1)])
        sizes = {**dict(self.run.manifest.images), **_sizes(self.run.manifest.rig)}
        errors = {name: counts.tolist() for name, counts in self.errors.items()} if self.outcomes else None
        line = {**self.timeline, "errors": errors}
        cameras = {name: list(size) for name, size in sorted(sizes.items())}
        return {"label": self.label, "timeline": line, "cameras": cameras, "frames": rows, "chunks": chunks}


def _best(outcomes: dict[tuple[int, str], str]) -> dict[int, str]:
    """Return outcomes by row, of boxes that were compared in several images the best."""
    found: dict[int, str] = {}
    for (row, _), outcome in outcomes.items():
        found[row] = min(found.get(row, outcome), outcome, key=_RANK.index)
    return found


def _flat_pose(pose: Float64) -> list[float]:
    """Return x, y [m] and heading [rad] of a pose: position and quaternion x, y, z, w."""
    x, y, _, i, j, k, w = pose.tolist()
    return [round(x, 2), round(y, 2), round(float(np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))), 4)]


def _sizes(rig: Rig) -> dict[str, list[int]]:
    return {name: list(camera.size_wh) for name, camera in sorted(rig.cameras.items())}
