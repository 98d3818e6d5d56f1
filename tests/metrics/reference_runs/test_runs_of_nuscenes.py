"""A run of a nuScenes log scores as the submission that it is exported to."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.replay.formats.exports import exported, run_of, stamp, sweeps, write_log

from fbench.metrics.profiles.catalog import profile_of
from fbench.metrics.profiles.choose import run_sequence
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import text_array
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Pose, Truth
from fbench.replay.runs.folder import Run

NUM, NUM_TRACKS = 16, 24
TOKENS = [f"token{i:02d}" for i in range(NUM)]
KINDS = {
    "vehicle.car": "car", "vehicle.truck": "truck", "human.pedestrian.adult": "pedestrian", "barrier": "other",
    "vehicle.bus.rigid": "bus", "vehicle.bicycle": "bicycle", "movable_object.trafficcone": "other",
    "vehicle.emergency.police": "car",
}  # fmt: skip
ATTRIBUTES = ("vehicle.moving", "vehicle.parked", "pedestrian.standing", "cycle.with_rider")


def pose(i: int) -> Pose:
    turn = Rotation.from_euler("ZYX", [0.5 + 0.05 * i, 0.02, -0.01])
    return Pose("body", stamp(i), stamp(i), np.array([400.0 + 2 * i, 1200.0 + i, 1.5]), turn.as_quat())


def drive(seed: int = 3) -> tuple[list[Boxes3D], list[Boxes3D]]:
    """Truth and results of each sample, in body coordinates."""
    rng = np.random.Generator(np.random.PCG64(seed))
    kinds = rng.choice(list(KINDS), NUM_TRACKS)
    start, speed = rng.uniform(-35, 35, (NUM_TRACKS, 2)), rng.uniform(-0.7, 0.7, (NUM_TRACKS, 2))
    score = np.round(rng.uniform(0.2, 1, NUM_TRACKS), 3)
    truths, results = [], []
    for i in range(NUM):
        there = np.flatnonzero(rng.random(NUM_TRACKS) < 0.85)
        place = start + i * speed
        truths.append(boxes(rng, kinds[there], place[there], there, truth=True))
        found = there[rng.random(len(there)) < 0.9]
        kind = np.where(rng.random(len(found)) < 0.9, kinds[found], "vehicle.car")
        near = place[found] + rng.normal(0, 0.5, (len(found), 2))
        ids = found + 50 * (rng.random(len(found)) < 0.05)
        results.append(boxes(rng, kind, near, ids, truth=False, score=score[found]))
    return truths, results


def boxes(rng: np.random.Generator, kinds, xy, ids, truth: bool, score=None) -> Boxes3D:
    n = len(kinds)
    common = {
        "label": text_array([KINDS[kind] for kind in kinds]), "source_label": text_array(kinds.tolist()),
        "track_id": ids.astype(np.int64), "velocity_mps": rng.uniform(-3, 3, (n, 3)) * (1, 1, 0),
        "attribute": text_array(rng.choice(ATTRIBUTES, n).tolist()),
    }  # fmt: skip
    if truth:
        common |= {"num_lidar_pts": rng.integers(0, 4, n), "num_radar_pts": rng.integers(0, 2, n)}
    else:
        common |= {"score": score}
    size = rng.uniform(0.9, 1.1, (n, 3)) * (4.0, 1.8, 1.5)
    return Boxes3D(np.column_stack([xy, rng.normal(0, 0.2, n)]), size, rng.uniform(-3, 3, n), **common)


def made_run(tmp_path: Path, truths, results, poses=True) -> Run:
    items: list[Any] = [*sweeps(NUM, range(NUM)), *(pose(i) for i in range(NUM) if poses)]
    items += [Truth(stamp(i), stamp(i), truth, None, i) for i, truth in enumerate(truths)]
    log = write_log(tmp_path / "scene-1.mcap", items, {"nuscenes.sample_tokens": " ".join(TOKENS)})
    return Run(run_of(log, lambda i: results[i]))


def files(tmp_path: Path, run: Run, form: str, truths) -> tuple[Path, Path]:
    """Truth as a submission with points, beside the table of samples; results."""
    truth, results = tmp_path / "truth" / "truth.json", tmp_path / "results.json"
    truth.parent.mkdir()
    exported(form, truth, run.folder, boxes="truth")
    exported(form, results, run.folder)
    content = json.loads(truth.read_text())
    for i, own in enumerate(truths):
        world = Rotation.from_quat(pose(i).rotation_xyzw).apply(np.array(own.center_m)) + pose(i).translation_m
        points = own.num_lidar_pts + own.num_radar_pts
        for box in content["results"][TOKENS[i]]:
            nearest = np.abs(world - box["translation"]).sum(axis=1).argmin()
            box["num_pts"] = int(points[nearest])
    truth.write_text(json.dumps(content))
    with (truth.parent / "samples.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["token", "stamp_ns", "scene", "ego_x", "ego_y", "ego_z"])
        rows.writerows([token, stamp(i), "scene-1", *pose(i).translation_m] for i, token in enumerate(TOKENS))
    return truth, results


@pytest.mark.parametrize(("profile", "form"), [("nuscenes-detection", "nuscenes"), ("nuscenes-tracking",) * 2])
def test_as_the_submission(profile, form, tmp_path, scored):
    truths, results = drive()
    run = made_run(tmp_path, truths, results)
    truth, submission = files(tmp_path, run, form, truths)
    own = scored(run.folder, "--profile", profile)
    expected = scored("--truth", truth, "--detections", submission, "--profile", profile)
    assert list(own) == list(expected)
    # Left out as of unknown class are those that a submission can't hold.
    unknown = {"unknown_class", "unknown_class_truth"}
    for key, (value, counts) in expected.items():
        assert own[key][0] == (None if value is None else pytest.approx(value, abs=2e-5)), key
        strip = [{k: v for k, v in c.items() if k not in unknown} for c in (own[key][1], counts)]
        assert strip[0] == (pytest.approx(strip[1], abs=2e-5)), key
    main = {"nuscenes-detection": "nds", "nuscenes-tracking": "amota"}[profile]
    assert 0.05 < next(value for (metric, *_), (value, _) in own.items() if metric == main) < 0.95


def test_what_a_run_cant_give(tmp_path):
    truths, results = drive()
    run = made_run(tmp_path, truths, results, poses=False)
    with pytest.raises(MetricError, match="doesn't tell where the body was"):
        run_sequence(run, profile_of("nuscenes-tracking"))
    # Frames by themselves can be scored where the body is.
    assert run_sequence(run, profile_of("nuscenes-detection")).ego_m is None


@pytest.mark.parametrize("profile", ["nuscenes-detection", "av2", "av2-tracking", "waymo"])
def test_results_without_classes_are_told(profile, tmp_path, program, capsys):
    truths, results = drive()
    bare = [Boxes3D(b.center_m, b.size_lwh_m, b.yaw_rad, track_id=b.track_id, score=b.score) for b in results]
    run = made_run(tmp_path, truths, bare)
    assert program("score", run.folder, "--profile", profile) == 0
    assert "the results have no classes" in capsys.readouterr().err


def test_at_most_500_results_of_a_sample(tmp_path):
    rng = np.random.Generator(np.random.PCG64(1))
    truths, results = drive()
    score = np.round(rng.random(700), 3)
    many = boxes(rng, np.full(700, "vehicle.car"), rng.uniform(-40, 40, (700, 2)), np.arange(700), False, score)
    sequence = run_sequence(made_run(tmp_path, truths, [many, *results[1:]]), profile_of("nuscenes-detection"))
    first = sequence.estimates[sequence.estimates.step == 0]
    assert sorted(first.score) == sorted(score)[200:]


def test_racks_stay_in_truth(tmp_path):
    truths, results = drive()
    racks = truths[0][np.arange(2)]
    labels = np.array(["static_object.bicycle_rack", "vehicle.car"])
    truths[0] = Boxes3D(
        racks.center_m, racks.size_lwh_m, racks.yaw_rad, label=np.array(["other", "car"]), source_label=labels
    )
    sequence = run_sequence(made_run(tmp_path, truths, results), profile_of("nuscenes-detection"))
    assert sorted(sequence.truth.label[sequence.truth.step == 0]) == ["car", "static_object.bicycle_rack"]
