"""Small runs for reports."""

import base64
import json
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.reports import chromium as driver

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.details import Details, save_details
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.data.scores import Score, save_scores
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter
from fbench.replay.runs.manifest import ConditionEntry, FrameEntry, LogEntry, Manifest, rig_entry
from fbench.replay.runs.media import MediaFrame, Picture, Points
from fbench.reports.html import HtmlReport

FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])
"""Camera axes (right, down, forward) on body axes (forward, left, up)."""
RIG = Rig(
    {
        "cam": Mount("camera", np.zeros(3), FORWARD),
        "top": Mount("lidar", np.zeros(3), np.array([0.0, 0, 0, 1])),
        "radar": Mount("radar", np.zeros(3), np.array([0.0, 0, 0, 1])),
    },
    {"cam": CameraModel(np.array([[100.0, 0, 79.5], [0, 100.0, 59.5], [0, 0, 1]]), (160, 120))},
)
LATENCY: dict[str, Any] = {
    "budget_ms": 100.0, "frames": 4, "over_budget": 1, "over_budget_share": 0.25, "percentile_method": "nearest rank",
    "excluded": "waiting for sensors",
    "stages": [
        {"stage": "detect.lidar", "count": 4, "first_ms": 31.0, "mean_ms": 12.0, "p50_ms": 11.5, "p90_ms": 18.5,
         "p95_ms": 20.25, "p99_ms": 22.0, "max_ms": 22.0, "cpu_mean_ms": 9.5},
        {"stage": "total", "count": 4, "first_ms": 131.0, "mean_ms": 82.0, "p50_ms": 75.5, "p95_ms": 130.0,
         "p99_ms": 131.0, "max_ms": 1131.0},
    ],
}  # fmt: skip


def boxes3d(label: str = "car") -> Boxes3D:
    """One box, 4 x 2 x 2 m, 10 m ahead, driving 3 m/s forward and 4 m/s to the left."""
    return Boxes3D(
        np.array([[10.0, 0, 0]]), np.array([[4.0, 2, 2]]), np.zeros(1), velocity_mps=np.array([[3.0, 4, 0]]),
        label=np.array([label]), score=np.array([0.875]), track_id=np.array([7]), sources=np.array([6], np.uint8),
    )  # fmt: skip


def boxes2d(label: str = "car") -> Boxes2D:
    """One box in `cam`, 25 m away and 1.5 m/s nearing."""
    return Boxes2D(
        np.array(["cam"]), np.array([[10.0, 20, 50, 60]]), label=np.array([label]), score=np.array([0.5]),
        track_id=np.array([3]), distance_m=np.array([25.0]), range_rate_mps=np.array([-1.5]),
        sources=np.array([1], np.uint8),
    )  # fmt: skip


def score(metric: str, value: float | None, reason: str | None = None, **changes: Any) -> Score:
    """One row of `scores.json`."""
    row: dict[str, Any] = {"class_": "vehicle", "slice": "all", "matching": "bev 2 m", "unit": "1", "counts": {}}
    return Score(metric, value=value, reason=reason, **{**row, **changes})


SCORES = (
    score("f1", 0.8571, counts={"tp": 6, "fp": 1, "fn": 1}),
    score("mota", None, "truth has no track ids"),
    score("motp", 0.25, unit="m"),
    score("idsw", 3.0),
    score("f1", 0.5, matching="iou 0.5"),
    score("f1", 0.25, class_="pedestrian"),
    score("coverage", 0.75, matching=""),
)


@dataclass(frozen=True)
class Plan:
    """What a test's run is like."""

    name: str = "run"
    log: str = "street"
    pipeline: str = "late3d"
    label: str = "car"
    make_boxes: Callable[[str], Boxes] = boxes3d
    truth: bool = True
    complete: bool = True
    missing: Mapping[str, str] = field(default_factory=dict)
    """In frame 1."""
    failed: str | None = None
    """In frame 2."""
    faults: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=lambda: {"lidar": {"cluster": {"eps_m": 0.6}}, "every": 1})
    scores: Sequence[Score] | None = SCORES
    details: Details | None = None
    latency: Any = field(default_factory=lambda: LATENCY)
    total_ms: float = 75.0
    num_frames: int = 4
    metadata: Mapping[str, str] = field(default_factory=lambda: {"place": "here"})
    conditions: Sequence[ConditionEntry] = ()
    log_digest: str = "aabbccddeeff00112233"
    excerpt: str = "all"
    first_truth: int = 0
    """Frames before it are labeled as empty."""


def media(index: int) -> MediaFrame:
    """A picture, and two points of each sensor."""
    xyz = np.array([[1.0, -2, 0.5], [30, 4, 1]], np.float32)
    jpeg = encode_jpeg(np.full((60, 80, 3), 90 + index, np.uint8))
    still, measured = np.full(2, np.nan, np.float32), np.array([-5.25, 2], np.float32)
    return MediaFrame(
        index, {"cam": Picture(jpeg, (80, 60))}, {"top": Points(xyz, still), "radar": Points(xyz, measured)}
    )


@pytest.fixture(scope="session")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[driver.Chromium]:
    """A browser for all tests of a process."""
    with driver.start(tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


@pytest.fixture
def make_run(tmp_path: Path) -> Callable[[Plan], Run]:
    """Write a run folder with two segments; frames 0 and 2 are kept."""

    def make(plan: Plan) -> Run:
        faults = FaultLog()
        for code, where in plan.faults.items():
            faults.add(code, where)
        with RunWriter(tmp_path / plan.name) as writer:
            for index in range(plan.num_frames):
                _add_frame(writer, plan, index)
            writer.write_media([media(index) for index in range(0, plan.num_frames, 2)])
            writer.write_json("faults.json", {"lost": faults.num_lost, "rows": faults.rows()})
            writer.write_json("host.json", {"rate": "max", "cpu": "Example CPU", "cores": 2, "wall_s": 1.234})
            folder = writer.finish(_manifest(plan))
        if plan.latency is not None:
            (folder / "latency.json").write_text(json.dumps(plan.latency))
        if plan.scores is not None:
            save_scores(folder / "scores.json", plan.scores)
        if plan.details is not None:
            save_details(folder, plan.details)
        return Run(folder)

    return make


def _add_frame(writer: RunWriter, plan: Plan, index: int) -> None:
    stamp_ns = index * 100_000_000 + (index >= 2) * 5_000_000_000
    missing = plan.missing if index == 1 else {}
    failed = plan.failed if index == 2 else None
    record = FrameRecord(index, stamp_ns, int(index >= 2), None, missing, "00", "00", failed)
    writer.add_frame(record, {"detect.lidar": 12_000_000, "total": int(plan.total_ms * 1e6)})
    boxes = plan.make_boxes(plan.label)
    writer.add_boxes("detections", index, boxes[:0] if failed else boxes)
    writer.add_boxes("tracks", index, boxes[:0] if failed else boxes)
    if plan.truth:
        writer.label_frame(
            index, Truth(stamp_ns, stamp_ns, boxes3d=boxes3d(plan.label)[: int(index >= plan.first_truth)])
        )


def _manifest(plan: Plan) -> Manifest:
    entry = rig_entry(0, RIG)
    return Manifest(
        complete=plan.complete,
        log=LogEntry(name=plan.log, log_id="id-1", digest=plan.log_digest, metadata=dict(plan.metadata)),
        pipeline=plan.pipeline,
        parameters=dict(plan.parameters),
        conditions=list(plan.conditions),
        frames=FrameEntry(
            reference="top",
            timeout_ns=30_000_000,
            tolerance_ns=50_000_000,
            max_gap_ns=2_000_000_000,
            max_jump_ns=1_000_000_000,
            excerpt=plan.excerpt,
        ),
        mounts=entry.mounts,
        cameras=entry.cameras,
        num_frames=plan.num_frames,
        num_segments=2 if plan.num_frames else 0,
        digest="99887766554433221100",
        versions={"fbench": "0.1.0", "numpy": "2.4.6"},
    )


class Page(HTMLParser):
    """A parsed report."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.html, self.tags, self.attributes = html, list[str](), list[tuple[str, str | None]]()
        self.islands, self._texts, self._raw, self._id = dict[str, str](), list[str](), "", ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag in ("script", "style"):
            self._raw, self._id = tag, dict(attrs).get("id") or ""

    def handle_endtag(self, tag: str) -> None:
        self._raw = "" if tag == self._raw else self._raw

    def handle_data(self, data: str) -> None:
        if not self._raw:
            self._texts.append(data)
        elif self._id:
            self.islands[self._id] = self.islands.get(self._id, "") + data

    @property
    def text(self) -> str:
        """What a reader sees, with single spaces."""
        return " ".join(" ".join(self._texts).split())

    @property
    def data(self) -> Any:
        """What the scripts read."""
        return json.loads(self.islands["data"])

    def content(self, number: int) -> bytes:
        """A content that the scripts decode when they show it."""
        return base64.b64decode(self.islands["store"].split("\n")[number])

    def inflate(self, number: int) -> bytes:
        """Points or boxes, which are compressed."""
        return zlib.decompress(self.content(number), -15)

    def frames(self, run: int = 0) -> list[Any]:
        """The frames of a run as the scripts put them together."""
        data = self.data
        one, found = data["runs"][run], list[Any]()
        media = dict(one["media"])
        for row, at in zip(one["frames"], range(len(one["frames"])), strict=True):
            both = one["chunks"][at // data["chunk"]]
            truth, results = (json.loads(self.inflate(number))[at % data["chunk"]] for number in both)
            found.append({**results, "index": row, "truth": truth, **media.get(row, {"pictures": {}, "clouds": []})})
        return found


@pytest.fixture
def report(tmp_path: Path) -> Callable[..., Page]:
    """Write a report and parse it."""

    def write(*runs: Run) -> Page:
        out = tmp_path / "out" / "report.html"
        HtmlReport().write(runs, out)
        return Page(out.read_text("utf-8"))

    return write
