"""The whole way on a real recording: import, replay into every pipeline, scores, report. Skips where it is absent."""

import hashlib
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from tests.program import fbench

from fbench.replay.runs.folder import Run

pytestmark = pytest.mark.slow
SKETCH_F1 = {"camera2d": 0.62, "lidar3d": 0.19, "radar3d": 0.26, "late3d": 0.35}
"""What a throw-away sketch reached on the same 47 frames; a regression below it would be a disgrace."""
LEAST_F1 = {"lidar3d": 0.52, "radar3d": 0.74, "early3d": 0.80, "late3d": 0.82}
"""Of vehicles, matched within 2 m: a good way below what was measured, so that only a loss trips them."""
PIPELINES = ("camera2d", *LEAST_F1)
MEASURED = ("timings.parquet", "latency.json", "host.json", "report.html")


@pytest.fixture(scope="module")
def folder(shared, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("astyx")
    assert fbench("log", "import", "astyx", shared / "data" / "astyx", "-o", folder / "astyx.mcap") == 0
    return folder


@pytest.fixture(scope="module")
def weights(shared) -> str:
    return f"camera.weights={shared}/weights/deimv2_femto/deimv2_hgnetv2_femto_coco.onnx"


@pytest.fixture(scope="module")
def runs(folder, weights) -> dict[str, Run]:
    for pipeline in PIPELINES:
        settings = ["--set", weights] if pipeline in ("camera2d", "early3d", "late3d") else []
        assert fbench("replay", folder / "astyx.mcap", "-p", pipeline, *settings, "-o", folder / pipeline) == 0
    return {pipeline: Run(folder / pipeline) for pipeline in PIPELINES}


def f1(run: Run) -> float:
    first = run.scores[0]
    assert (first.metric, first.class_) == ("f1", "vehicle")
    assert first.value is not None
    return first.value


def test_foreign_reader_decodes_every_message(folder):
    with (folder / "astyx.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        decoded = [(schema.name, message) for schema, _, _, message in reader.iter_decoded_messages()]
    num = {name: sum(n == name for n, _ in decoded) for name, _ in decoded}
    assert num["foxglove.CompressedImage"] == 47
    assert num["foxglove.PointCloud"] == 2 * 47
    assert num["foxglove.SceneUpdate"] == 47
    assert num["foxglove.FrameTransform"] == 3
    assert num["foxglove.CameraCalibration"] == 1
    clouds = [m for n, m in decoded if n == "foxglove.PointCloud"]
    assert {f.name for m in clouds for f in m.fields} >= {"x", "y", "z", "intensity", "ring", "velocity", "rcs"}


def test_four_stretches_are_four_segments_and_nothing_is_missing(runs):
    for run in runs.values():
        assert (run.manifest.num_frames, run.manifest.num_segments) == (47, 4)
        assert [f.index for f in run.frames if f.missing or f.failed] == []
        assert run.manifest.complete


def test_scores_beat_the_sketch_and_fusion_beats_its_inputs(runs):
    scores = {name: f1(run) for name, run in runs.items()}
    for name, sketch in SKETCH_F1.items():
        assert scores[name] > sketch, scores
    assert scores["late3d"] > max(scores["lidar3d"], scores["radar3d"]) + 0.02, scores


@pytest.mark.parametrize("pipeline", LEAST_F1)
def test_f1_of_vehicles(runs, pipeline):
    bev = [row for row in runs[pipeline].scores if row.metric == "f1" and row.matching.startswith("bev 2 m")]
    assert bev[0].class_ == "vehicle"
    assert bev[0].value > LEAST_F1[pipeline]


def test_tracks_are_not_scored_without_truth_ids(runs):
    mota = next(s for s in runs["late3d"].scores if s.metric == "mota")
    assert (mota.value, mota.reason) == (None, "truth has no track ids")


def test_rate_changes_nothing(folder, weights, runs):
    assert (
        fbench("replay", folder / "astyx.mcap", "-p", "late3d", "--set", weights, "--rate", "2", "-o", folder / "slow")
        == 0
    )
    files = sorted(p.name for p in runs["late3d"].folder.iterdir() if p.name not in MEASURED)
    for name in files:
        a, b = ((f / name).read_bytes() for f in (runs["late3d"].folder, folder / "slow"))
        assert hashlib.sha256(a).digest() == hashlib.sha256(b).digest(), name


def test_one_report_holds_all_runs(folder, runs):
    assert fbench("report", *(run.folder for run in runs.values()), "-o", folder / "all.html") == 0
    page = (folder / "all.html").read_text()
    for name in runs:
        assert name in page
    assert len(page) < 8_000_000
