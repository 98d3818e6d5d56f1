"""A run of a KITTI log scores as the files that it came from."""

from pathlib import Path

import numpy as np
import pytest
from tests.metrics.reference_runs.kitti_drive import write_results, write_truth
from tests.replay.formats.exports import rig, run_of, solids, stamp, sweeps, write_log

from fbench.metrics.profiles.catalog import profile_names, profile_of
from fbench.metrics.profiles.choose import run_sequence
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.messages import Truth
from fbench.replay.runs.folder import Run

IN_IMAGES, IN_SPACE = ("trackeval-kitti", "kitti-object"), ("trackeval-kitti", "kitti-3dmot", "kitti-object")


def made_run(program, root: Path, results: Path, out: Path, sequence: str = "0000") -> Run:
    log = out.with_suffix(".mcap")
    chosen = ("--scenes", sequence, "--detections", results)
    assert program("log", "import", "kitti", root, "-o", log, *chosen) == 0
    assert program("replay", log, "-p", "recorded", "-o", out) == 0
    return Run(out)


@pytest.fixture
def drive(tmp_path: Path, program):
    """Truth, results in images, results in 3D, and the run of each."""
    root, flat, solid = tmp_path / "set", tmp_path / "flat", tmp_path / "solid"
    write_truth(root, 7)
    write_results(root / "label_02/0000.txt", flat, 8, None)
    flat_run = made_run(program, root, flat, tmp_path / "flat_run")
    write_results(root / "label_02/0000.txt", solid, 9, flat_run.manifest.rig)
    return {"flat": (flat, flat_run), "solid": (solid, made_run(program, root, solid, tmp_path / "solid_run"))}


def assert_same(run_rows, file_rows):
    assert list(run_rows) == list(file_rows)
    for key, (value, counts) in file_rows.items():
        assert run_rows[key][0] == (None if value is None else pytest.approx(value, abs=1e-9)), key
        assert run_rows[key][1] == counts, key


@pytest.mark.parametrize(("kind", "profile"), [*[("flat", p) for p in IN_IMAGES], *[("solid", p) for p in IN_SPACE]])
def test_as_the_files(kind, profile, drive, scored, tmp_path):
    results, run = drive[kind]
    truth = tmp_path / "set/label_02"
    own = scored(run.folder, "--profile", profile)
    files = scored(
        "--truth", truth, "--detections", results, "--profile", profile, "--seqmap",
        tmp_path / "set/evaluate_tracking.seqmap",
    )  # fmt: skip
    assert_same(own, files)
    # What is compared isn't trivial.
    if kind == "solid" or profile.startswith("trackeval"):
        name = {"kitti-3dmot": "samota", "trackeval-kitti": "hota", "kitti-object": "ap"}[profile]
        values = [
            value
            for (metric, class_, *_), (value, _) in own.items()
            if (metric, class_) == (name, "car") and value is not None
        ]
        assert 0.02 < max(values) < 0.98


def test_what_a_run_in_images_cant_give(drive):
    run = drive["flat"][1]
    with pytest.raises(MetricError, match="kitti-3dmot needs 3D boxes, and the results are in images"):
        run_sequence(run, profile_of("kitti-3dmot"))
    flat = Match("iou2d", 0.5)
    assert len(run_sequence(run, profile_of("kitti-3dmot").with_match(flat), flat).estimates)


def test_without_truth_there_is_nothing_to_score(tmp_path):
    log = write_log(tmp_path / "bare.mcap", sweeps(3))
    run = Run(run_of(log, lambda i: solids([10.0], track_id=[1])))
    for name in profile_names():
        with pytest.raises(MetricError, match="no truth, so there is nothing to score") as told:
            run_sequence(run, profile_of(name), Match("iou3d", 0.5) if name == "default" else None)
        assert told.value.code == "GT001"


def test_several_cameras_are_streams_in_images_and_nothing_in_space(tmp_path):
    of = rig("front", "left")
    truths = [Truth(stamp(i), stamp(i), solids([12.0, 30.0], track_id=[1, 2])) for i in range(3)]
    log = write_log(tmp_path / "two.mcap", [*sweeps(3), *truths], of=of)
    bad = np.array([[12.0, 0, 0], [np.nan, 0, 0]])
    run = Run(run_of(log, lambda i: solids([12.0, 30.0], track_id=[1, 2], center_m=bad)))
    flat = run_sequence(run, profile_of("trackeval-kitti"))
    assert (len(flat.steps), len(set(flat.steps.stream)), len(flat.truth), len(flat.estimates)) == (6, 2, 12, 9)
    solid = run_sequence(run, profile_of("kitti-3dmot"))
    assert (len(solid.steps), len(solid.truth), len(solid.estimates), solid.truth.xyxy_px) == (3, 6, 6, None)


@pytest.mark.slow
@pytest.mark.parametrize("sequence", ["0001", "0012"])
def test_real_sequences(sequence, shared, program, scored, tmp_path):
    root = shared / "data/kitti_tracking"
    if not (root / "trackers_2d/GT-SORT").is_dir():
        pytest.skip(f"{root}: no KITTI tracking data")
    flat, solid = root / "trackers_2d/GT-SORT", tmp_path / "solid"
    run = made_run(program, root, flat, tmp_path / "flat_run", sequence)
    write_results(root / f"label_02/{sequence}.txt", solid, 9, run.manifest.rig)
    in_space = made_run(program, root, solid, tmp_path / "solid_run", sequence)
    chosen = ("--truth", root / "label_02", "--sequences", sequence, "--missing", "empty", "--seqmap",
              root / "evaluate_tracking.seqmap.training")  # fmt: skip
    for results, own, profiles in ((flat, run, IN_IMAGES), (solid, in_space, IN_SPACE)):
        for profile in profiles:
            files = scored(*chosen, "--detections", results, "--profile", profile)
            assert_same(scored(own.folder, "--profile", profile), files)
