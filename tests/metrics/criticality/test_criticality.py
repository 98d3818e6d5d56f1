"""Critical errors of a drive toward a standing car, in numbers that can be told by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.metrics.conftest import boxes2d, boxes3d, front_camera, make_manifest

from fbench.metrics.comparison.cells import CellName, CellPair, CellSide, Stretches
from fbench.metrics.comparison.counts import RATIOS, Place, count_frames
from fbench.metrics.criticality.metric import Criticality, find_critical_errors
from fbench.metrics.criticality.scores import WEIGHT_BITS
from fbench.metrics.runs.combine import combine_runs, measure_run
from fbench.replay.contracts.errors import RunError
from fbench.replay.data.arrays import Int64
from fbench.replay.data.boxes import Boxes, Boxes3D
from fbench.replay.data.criticality import load_critical_errors, save_critical_errors
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter

OPTIONS = ScoreOptions()
START_NS, STEP_NS = 1_700_000_000_000_000_000, 100_000_000
NUM, MISSED, GHOST = 10, (5, 6, 7), (0, 1)
GAPS = np.array([40 - k - 2 - 3.7 for k in range(NUM)])  # From the ego's front to the car's rear, 10 m/s apart
WEIGHTS = np.maximum(1 - GAPS / 10 / 5, 100 / (2 * GAPS) / 8)


def truth_at(k: int, speed: float | None = 0.0, number: int = 1) -> Boxes3D:
    """A car that stands 40 m ahead of the ego's first place."""
    car = boxes3d((40 - k, 0), label="car", ids=[number])
    return car if speed is None else replace(car, velocity_mps=np.array([[speed, 0.0, 0.0]]))


def found_at(k: int) -> Boxes3D:
    """It is missed for three frames; in the first two a ghost stands 10 m ahead of the ego's first place."""
    places = [(40 - k, 0.5)] * (k not in MISSED) + [(10 - k, 0)] * (k in GHOST)
    numbers = [4] * (k not in MISSED) + [9] * (k in GHOST)
    return boxes3d(*places, label="car", score=[1.0] * len(places), ids=numbers)


def write(
    folder: Path, truths: list[Boxes3D], found: list[Boxes], angle: float | None = 0.0, at: complex = 0j,
    start_ns: int = START_NS, rig: Rig | None = None,
) -> Run:  # fmt: skip
    """An ego that drives 10 m/s in a direction of the world; without poses where the angle is `None`."""
    with RunWriter(folder) as writer:
        for k, (truth, boxes) in enumerate(zip(truths, found, strict=True)):
            stamp_ns = start_ns + k * STEP_NS
            writer.add_frame(FrameRecord(k, stamp_ns, 0, None, {}, "", ""), {"total": 1})
            writer.add_boxes("detections", k, boxes)
            writer.add_boxes("tracks", k, boxes)
            writer.label_frame(k, Truth(stamp_ns, stamp_ns, truth, None))
        if angle is not None:
            places = at + np.exp(1j * angle) * np.arange(len(truths))
            turned = [0, 0, np.sin(angle / 2), np.cos(angle / 2)]
            writer.set_poses(np.array([[p.real, p.imag, 3.0, *turned] for p in places]))
        return Run(writer.finish(make_manifest(*([] if rig is None else [rig]))))


def drive(folder: Path, **how: object) -> Run:
    return write(folder, [truth_at(k) for k in range(NUM)], [found_at(k) for k in range(NUM)], **how)  # type: ignore[arg-type]


def rows(run: Run, class_: str = "vehicle") -> dict[str, Score]:
    return {row.metric: row for row in Criticality().scores(run, OPTIONS) if row.class_ == class_}


def values(run: Run) -> dict[str, float | None]:
    return {name: row.value for name, row in rows(run).items()}


def expected() -> dict[str, float]:
    hit = float(WEIGHTS.sum() - WEIGHTS[list(MISSED)].sum())
    truth, ghosts = float(WEIGHTS.sum()), 2.0  # 4.3 m take 11.6 m/s^2, more than 8: weight 1; 3.3 m more than 12
    brake = 100 / (2 * GAPS[7])
    return {
        "critical_misses": 3, "critical_false_alarms": 2, "weighted_recall": hit / truth,
        "weighted_f1": 2 * hit / (hit + truth + ghosts), "critical_untracked": 3, "critical_false_tracks": 2,
        "weighted_mota": (hit - ghosts) / truth, "mdr": brake,
        "lea": 2 * (1 + 0.9) / (GAPS[7] / 10) ** 2, "fsr": 0.1 * (100 / (2 * 4.3) + 12),
    }  # fmt: skip


def test_a_drive_toward_a_standing_car(tmp_path: Path) -> None:
    run = drive(tmp_path / "run")
    found = values(run)
    assert {name: found[name] for name in expected()} == pytest.approx(expected())
    # 0.5 m aside: the rear face is as far ahead, its two corners lie on the line of the other one, one of them on it
    assert (found["surface_error"], found["support_distance_error"]) == (0.0, 0.0)
    assert found["contour_error"] == pytest.approx(0.25)
    assert rows(run, "car")["critical_misses"].value == 3
    miss, ghost = rows(run)["critical_misses"].counts, rows(run)["critical_false_alarms"].counts
    assert (miss["critical"], miss["truth"], miss["unknown_truth"]) == (5, 10, 0)
    assert (ghost["alarms"], ghost["unknown_alarms"]) == (2, 0)


def test_critical_errors_have_times(tmp_path: Path) -> None:
    run = drive(tmp_path / "run")
    errors = find_critical_errors(run, OPTIONS)
    assert [(e.kind, e.side, e.name, e.first_frame, e.last_frame, e.num_frames) for e in errors] == [
        ("false alarm", "detections", "car #9", 0, 1, 2),
        ("false alarm", "tracks", "car #9", 0, 1, 2),
        ("miss", "detections", "car #1", 5, 7, 3),
        ("miss", "tracks", "car #1", 5, 7, 3),
    ]
    miss = errors[2]
    assert miss.stamp_ns == START_NS + 5 * STEP_NS
    assert (miss.from_s, miss.to_s, miss.range_m) == pytest.approx((0.5, 0.7, 33))
    assert (miss.ttc_s, miss.deceleration_mps2) == pytest.approx((GAPS[7] / 10, 100 / (2 * GAPS[7])))
    assert str(miss) == "miss: car #1 at 0.5-0.7 s, frame 5-7, 33 m away: 2.7 s to collision, 1.8 m/s² to brake"
    save_critical_errors(run.folder, errors)
    assert load_critical_errors(run.folder) == errors
    text = (run.folder / "criticality.json").read_text()
    for damage in ("{", "[1]", '[{"kind": 1}]', text.replace('"lateral_mps2": ', '"lateral_mps2": "hard", "was": ')):
        (run.folder / "criticality.json").write_text(damage)
        with pytest.raises(RunError, match="not a list of critical errors"):
            load_critical_errors(run.folder)


@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.floats(-3, 3), st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.integers(0, 2**61))
def test_place_direction_and_time_change_nothing(
    tmp_path_factory: pytest.TempPathFactory, angle: float, x: float, y: float, start_ns: int
) -> None:
    run = drive(tmp_path_factory.mktemp("moved") / "run", angle=angle, at=complex(x, y), start_ns=start_ns)
    found = values(run)
    assert {name: found[name] for name in expected()} == pytest.approx(expected(), abs=1e-5)


def test_velocity_of_truth_follows_from_its_places(tmp_path: Path) -> None:
    truths = [truth_at(k, speed=None) for k in range(NUM)]
    found = values(write(tmp_path / "run", truths, [found_at(k) for k in range(NUM)]))
    assert {name: found[name] for name in expected()} == pytest.approx(expected(), abs=1e-9)


OF_MOTION = ("critical_misses", "weighted_recall", "weighted_f1", "critical_untracked", "weighted_mota", "mdr", "lea")
OF_RESULTS = ("critical_false_alarms", "critical_false_tracks", "fsr")


def test_without_poses_nothing_is_guessed(tmp_path: Path) -> None:
    run = drive(tmp_path / "run", angle=None)
    for name in (*OF_MOTION, *OF_RESULTS):
        row = rows(run)[name]
        assert row.value is None
        assert row.reason == "the motion of the ego isn't known: that takes poses at most 1 s apart"
    assert rows(run)["surface_error"].value == 0
    assert find_critical_errors(run, OPTIONS) == []


def test_truth_without_velocity_and_ids_is_unknown(tmp_path: Path) -> None:
    truths = [truth_at(k, speed=None, number=-1) for k in range(NUM)]
    run = write(tmp_path / "run", truths, [found_at(k) for k in range(NUM)])
    found = rows(run)
    for name in OF_MOTION:
        assert (found[name].value, found[name].reason) == (
            None, "truth has no velocities, nor ids to derive them from"
        )  # fmt: skip
    assert found["critical_false_tracks"].value == 2
    assert found["critical_misses"].counts["unknown_truth"] == NUM
    assert {e.kind for e in find_critical_errors(run, OPTIONS)} == {"false alarm"}


def test_one_frame_has_no_motion_of_the_ego(tmp_path: Path) -> None:
    assert rows(write(tmp_path / "run", [truth_at(0)], [found_at(0)]))["critical_misses"].value is None


def test_results_in_images_have_no_place(tmp_path: Path) -> None:
    flat = [boxes2d((300, 250, 500, 350), label="car", score=[1.0], ids=[1]) for _ in range(3)]
    found = rows(write(tmp_path / "run", [truth_at(k) for k in range(3)], [*flat], rig=front_camera()))
    assert {row.value for row in found.values()} == {None}
    assert {row.reason for row in found.values()} == {"results are in images; what is critical needs 3D boxes"}


def test_results_that_are_no_boxes_are_no_phantoms(tmp_path: Path) -> None:
    nowhere = replace(boxes3d((10, 0), label="car", score=[1.0], ids=[3]), yaw_rad=np.array([np.nan]))
    found = rows(write(tmp_path / "run", [truth_at(k) for k in range(3)], [nowhere] * 3))
    assert found["critical_false_alarms"].reason == "no false alarm is a finite box"
    assert found["critical_misses"].value == 0


def test_runs_are_added(tmp_path: Path) -> None:
    """Counts add up; a run that knows nothing of motion adds nothing."""
    one, other = drive(tmp_path / "one"), drive(tmp_path / "other", angle=None)
    measured = [measure_run(run, OPTIONS, metrics=[Criticality()]) for run in (one, one, other)]
    keys = [replace(m, key=(str(k), str(k), str(k))) for k, m in enumerate(measured)]

    def together(*numbers: int) -> dict[str, Score]:
        total = combine_runs([keys[k] for k in numbers])
        return {row.metric: row for row in total if row.class_ == "vehicle" and row.slice == "all"}

    both = together(0, 1)
    assert (both["critical_misses"].value, both["fsr"].value) == (6, pytest.approx(2 * expected()["fsr"]))
    assert both["mdr"].value == pytest.approx(expected()["mdr"])
    assert together(0, 2)["weighted_recall"].value == pytest.approx(expected()["weighted_recall"])
    assert together(2)["critical_misses"].value is None


def test_frames_add_up_to_the_rows_so_that_comparisons_can_test_them(tmp_path: Path) -> None:
    run = write(tmp_path / "run", [truth_at(k) for k in range(NUM)], [found_at(k) for k in range(NUM)])
    frames = count_frames(run, OPTIONS)
    place = next(own for own in frames.counts if own[:2] == ("critical detection", "vehicle"))
    misses, _, hit, truth, _, _ = frames.counts[place].T
    assert np.flatnonzero(misses).tolist() == list(MISSED)
    assert truth / 2**WEIGHT_BITS == pytest.approx(WEIGHTS, rel=1e-6)
    assert np.flatnonzero(hit == 0).tolist() == list(MISSED)
    rows = {row.key: row.value for row in Criticality().scores(run, OPTIONS)}
    tested = [key for key in rows if key in frames.totals]
    assert {key[0] for key in tested} == {*RATIOS["critical detection"], *RATIOS["critical tracking"]}
    assert [frames.totals[key] for key in tested] == pytest.approx([rows[key] for key in tested], abs=1e-6)


def test_a_baseline_that_counts_nothing_critical_has_no_test_of_it(tmp_path: Path) -> None:
    place = ("critical tracking", "vehicle", "all", "bev 2 m")
    new, old = ({place: np.ones((6, 6), np.int64)}, dict[Place, Int64]())
    sides = [CellSide(make_manifest(), [], None, Stretches("", held, ("",) * 6)) for held in (new, old)]
    name = CellName("log", "lidar3d")
    assert CellPair(name, sides[0], sides[1]).counts(place) is None
    assert CellPair(name, sides[0], sides[0]).counts(place) is not None
