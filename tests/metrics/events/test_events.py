"""Events of drives that can be told by hand."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.metrics.conftest import boxes2d, boxes3d, make_manifest
from tests.metrics.profiles.av2.oracles.av2_logs import PLANS, Log, logs_of
from tests.metrics.profiles.av2.test_av2 import FROZEN, of_log

from fbench.metrics.criticality.motion import EgoMotion, follow_ego
from fbench.metrics.events.finder import EVENTS, Found, find_events
from fbench.metrics.events.metric import Events
from fbench.metrics.events.scores import (
    compare_steps,
    count_arrivals,
    count_stretches,
    temporal_hota,
    value_of,
)
from fbench.metrics.runs.combine import combine_runs, measure_run
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.boxes import Boxes, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.data.sequences import Objects, Sequence, Steps
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter

NUM, STEP_S, START_NS = 40, 0.1, 1_700_000_000_000_000_000
TIMES = np.arange(NUM) * STEP_S
Place = Callable[[float], complex]


def steps(start_ns: int = START_NS) -> Steps:
    return Steps(np.arange(NUM), start_ns + (np.arange(NUM) * 100_000_000), np.zeros(NUM, np.int64))


def ego(place: Place, turn: complex = 1, at: complex = 0, start_ns: int = START_NS) -> EgoMotion:
    """An ego that looks along the world's x, before the world is turned and moved."""
    world = np.array([turn * place(t) + at for t in TIMES])
    angle = float(np.angle(turn))
    pose = [0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2)]
    poses = np.array([[p.real, p.imag, 0.0, *pose] for p in world])
    return follow_ego(np.arange(NUM), np.zeros(NUM, np.int64), steps(start_ns).stamp_ns, poses)


def bodies(ego_place: Place, *places: Place, label: str = "car", heading: float = 0.0) -> Objects:
    """Objects with ids at places of the world, seen from an ego that looks along x; without velocities."""
    n = len(places)
    center = np.array([[p(t) - ego_place(t) for p in places] for t in TIMES]).ravel()
    return Objects(
        step=np.repeat(np.arange(NUM), n), label=np.full(NUM * n, label), track_id=np.tile(np.arange(n), NUM),
        score=np.zeros(NUM * n), center_m=np.column_stack([center.real, center.imag, np.zeros(NUM * n)]),
        size_lwh_m=np.tile([4.0, 2.0, 1.5], (NUM * n, 1)), yaw_rad=np.full(NUM * n, heading),
    )  # fmt: skip


def driving(t: float) -> complex:
    """10 m/s."""
    return complex(10 * t, 0)


def standing(t: float) -> complex:
    return complex(0 * t, 0)


def find(objects: Objects, place: Place = driving) -> dict[str, list[int]]:
    """Steps of each event that occurs, of one object."""
    found = find_events(objects, steps(), ego(place))
    return {name: objects.step[rows].tolist() for name, rows in found.rows.items() if rows.any()}


def cutting(t: float) -> complex:
    """Two lanes over at first; from 1 s on 2 m/s to the right, so at 1.5 s 2.5 m and at 1.875 s 1.75 m beside."""
    return complex(20 + 10 * t, 3.5 - 2 * min(max(t - 1, 0), 1.5))


def test_cut_in_from_outside_until_a_second_after() -> None:
    # Outside up to 1.5 s (2.5 m), inside from 1.9 s on: from step 15 to step 29.
    assert find(bodies(driving, cutting)) == {"cut-in": list(range(15, 30))}
    # Too far ahead, against a standing ego, or slower than 4 s: none.
    assert find(bodies(driving, lambda t: cutting(t) + 25)) == {}
    assert find(bodies(standing, cutting), standing) == {}
    assert find(bodies(driving, lambda t: complex(20 + 10 * t, 3.5 - 0.05 * t))) == {}
    # A pedestrian doesn't cut in.
    assert find(bodies(driving, cutting, label="pedestrian")) == {}


def test_the_path_is_the_one_that_the_ego_drives() -> None:
    # It changes into the lane of a car that goes straight on: the car is on its path all the time, and cuts in nowhere.
    def changing(t: float) -> complex:
        return complex(10 * t, 3.5 * min(max(t - 1, 0), 1))

    assert find(bodies(changing, lambda t: complex(20 + 10 * t, 3.5)), changing) == {}


def test_crossing_from_three_seconds_before_the_path() -> None:
    # 2 m/s from 7 m on the left: at 0.5 s it is 3 s away; until it leaves the lane at the right: 8.75 m, 4.375 s
    walker = bodies(standing, lambda t: complex(15, 7 - 2 * t), label="pedestrian", heading=-np.pi / 2)
    assert find(walker, standing) == {"crossing": list(range(5, NUM))}
    away = bodies(standing, lambda t: complex(15, 3 + 2 * t), label="pedestrian", heading=np.pi / 2)
    assert find(away, standing) == {}
    behind = bodies(standing, lambda t: complex(-15, 7 - 2 * t), label="pedestrian", heading=-np.pi / 2)
    assert find(behind, standing) == {}


def test_hard_braking_ahead_in_the_lane() -> None:
    def braking(t: float) -> complex:  # 4 m/s^2 from 1 s on, at 10 m/s; it stands at 3.5 s
        s = min(max(t - 1, 0), 2.5)
        return complex(30 + 10 * min(t, 3.5) - 2 * s * s, 0)

    found = find(bodies(driving, braking))["hard braking"]
    # From 10 m/s down to 1 m/s: 1 s to 3.25 s. Parabolas through 1 s: at 1.1 s -2.7 m/s^2, at 1.2 s -3.3 m/s^2.
    assert found == list(range(12, 33))
    assert find(bodies(driving, lambda t: braking(t) + 3.5j)) == {}


def test_stopped_behind_and_oncoming() -> None:
    assert find(bodies(standing, lambda t: complex(8 + 0 * t, 0.5)), standing) == {"stopped behind": list(range(NUM))}
    assert find(bodies(standing, lambda t: complex(16 + 0 * t, 0.5)), standing) == {}  # 15 m
    turned = bodies(standing, lambda t: complex(8 + 0 * t, 0.5), heading=np.pi)
    assert find(turned, standing) == {}  # It stands there, but heads toward the ego
    # 65 m away, 20 m/s apart: from 60 m (0.25 s) to 0 m (3.25 s)
    come = bodies(driving, lambda t: complex(65 - 10 * t, 3.5), heading=np.pi)
    assert find(come) == {"oncoming": list(range(3, 33))}
    assert find(bodies(driving, lambda t: complex(65 - 10 * t, 7), heading=np.pi)) == {}


def with_sight(objects: Objects, share: np.ndarray) -> Objects:
    return replace(objects, visibility=share.astype(np.float64))


def test_what_appears() -> None:
    still = bodies(standing, lambda t: complex(35 + 0 * t, 10), label="pedestrian")
    share = np.where(np.arange(NUM) < 10, 0.1, 0.9)
    found = find(with_sight(still, share), standing)
    # Hidden for 1 s; then 2 s from step 10 on; first seen there, 36 m away.
    seen = list(range(10, 31))
    assert found == {"occluded then visible": seen, "first seen at distance": seen}
    share = np.where(
        (np.arange(NUM) >= 5) & (np.arange(NUM) < 9), 0.1, 0.9
    )  # hidden for 0.4 s, seen from the beginning
    assert find(with_sight(still, share), standing) == {}
    near = bodies(standing, lambda t: complex(20 + 0 * t, 10), label="pedestrian")
    share = np.where(np.arange(NUM) < 3, 0.3, 0.9)  # neither seen nor hidden at first, and near
    assert find(with_sight(near, share), standing) == {}
    # By points, where truth has no visible share: 0 are hidden, 5 are seen.
    points = replace(still, num_points=np.where(np.arange(NUM) < 10, 0, 5))
    assert set(find(points, standing)) == {"occluded then visible", "first seen at distance"}


@pytest.mark.parametrize(("turn", "at"), [(1, 0), (np.exp(2.1j), 500 - 300j), (np.exp(-3j), 0)])
@pytest.mark.parametrize("start_ns", [START_NS, 10_000_000_000])
def test_rigid_motion_and_time_shift_change_nothing(turn: complex, at: complex, start_ns: int) -> None:
    objects = bodies(
        driving, cutting, lambda t: complex(15.05, 7.05 - 2 * t), lambda t: complex(65 - 10 * t, 3.5), heading=0.3
    )
    expected = find_events(objects, steps(), ego(driving))
    found = find_events(objects, steps(start_ns), ego(driving, turn, at, start_ns))
    assert [name for name in EVENTS if expected.rows[name].any()] == ["cut-in", "crossing", "oncoming"]
    for name in EVENTS:
        assert found.rows[name].tolist() == expected.rows[name].tolist(), name


def test_nothing_is_said_of_what_is_not_known() -> None:
    objects = bodies(driving, cutting)
    nameless = replace(objects, track_id=np.full(NUM, -1))
    found = find_events(nameless, steps(), ego(driving))
    assert not found.known.any()
    assert found.unknown("cut-in", True) == "truth has no velocities, nor ids to derive them from"
    assert found.unknown("first seen at distance", True) == "truth has neither visibility nor point counts with ids"
    lost = find_events(objects, steps(), ego(lambda t: complex(np.nan, 0)))
    assert not any(rows.any() for rows in lost.rows.values())
    assert lost.unknown("oncoming", False) == "the motion of the ego isn't known: that takes poses at most 1 s apart"


def test_counts_by_hand() -> None:
    objects = bodies(driving, cutting, cutting)
    rows = np.flatnonzero((objects.track_id == 0) & ~np.isin(objects.step, (3, 4)))
    assert count_stretches(objects, rows, steps()) == 2
    assert compare_steps(np.array([0, 1, 1]), np.array([1, 2]), np.ones(5, bool)) == (1, 1, 1, 2)
    assert compare_steps(np.array([0, 1, 1]), np.array([1, 2]), np.array([1, 1, 1, 1, 0], bool)) == (1, 1, 1, 1)
    value, _ = value_of("timestamp_balanced_accuracy", {"tp": 1, "fp": 1, "fn": 1, "tn": 2})
    assert value == pytest.approx((1 / 2 + 2 / 3) / 2)
    assert value_of("timestamp_balanced_accuracy", {"tp": 1, "fp": 0, "fn": 0, "tn": 0})[0] is None
    # The track has the event in half of the frames in which truth has it, 1 m off: similarity 0.5.
    own = objects[objects.track_id == 0]
    moved = replace(own[:20], center_m=np.asarray(own.center_m)[:20] + np.array([0, 1.0, 0]))
    n = temporal_hota(own, moved, steps(), Match("bev", 2.0))
    assert n.tp[:10] == (20,) * 10
    assert n.tp[10:] == (0,) * 9
    # DetA 20 / 40, AssA 20 / 40 at ten of 19 thresholds
    counts: dict[str, int | float] = {"gt": 40, "estimates": 20}
    counts |= {f"tp {5 * k / 100:.2f}": n.tp[k - 1] for k in range(1, 20)}
    counts |= {f"assa {5 * k / 100:.2f}": float(n.ass_a[k - 1]) for k in range(1, 20)}
    assert value_of("hota_temporal", counts)[0] == pytest.approx(0.5 * 10 / 19)


@pytest.mark.parametrize("log", logs_of(PLANS["sparse"]), ids=lambda log: log.name)
def test_hota_temporal_and_balanced_accuracy_are_av2_apis(log: Log) -> None:
    # What is looked for is every bus; scores don't matter.
    sequence = of_log(log)
    truth, tracks = (side[side.label == "bus"] for side in (sequence.truth, sequence.estimates))
    hota = temporal_hota(truth, tracks, sequence.steps, Match("bev", 2.0))
    shares = [
        float(ass) / (tp + fn + fp) for ass, tp, fn, fp in zip(hota.ass_a, hota.tp, hota.fn, hota.fp, strict=True)
    ]
    theirs = FROZEN["mining"][log.name]
    assert np.mean(np.sqrt(shares)) == pytest.approx(theirs["hota"], abs=1e-9)
    known = np.ones(log.num_steps, bool)
    n = dict(zip(("tp", "fp", "fn", "tn"), compare_steps(truth.step, tracks.step, known), strict=True))
    value, why = value_of("timestamp_balanced_accuracy", n)
    if value is None:  # av2-api counts a share of nothing as 1
        assert "av2-api counts that half as 1" in str(why)
        has, lacks = n["tp"] + n["fn"], n["tn"] + n["fp"]
        value = ((n["tp"] / has if has else 1) + (n["tn"] / lacks if lacks else 1)) / 2
    assert value == pytest.approx(theirs["accuracy"], abs=1e-12)


def test_time_to_a_stable_track_by_hand() -> None:
    objects = bodies(driving, cutting)
    sequence = Sequence("s", steps(), objects, objects[:0])
    track = np.full(NUM, -1)
    track[[10, 11, 12]] = 7  # 0.2 s: too short
    track[14:18] = 7
    track[18:24] = 8  # 0.5 s with one track, from step 18 on
    first = np.array([4])
    n = count_arrivals(sequence, first, np.arange(NUM), track)
    assert (n.objects, n.followed, float(n.delay_s)) == (1, 1, pytest.approx(1.4))
    track[20] = -1
    n = count_arrivals(sequence, first, np.arange(NUM), track)
    assert (n.objects, n.followed) == (1, 0)
    # Where the object counts from step 10 on, outside the region before, nobody waits for it there.
    n = count_arrivals(sequence, first, np.arange(10, NUM), np.full(NUM - 10, 7))
    assert (n.objects, n.followed, float(n.delay_s)) == (1, 1, 0.0)
    # Truth that doesn't count, outside the region or of another class, isn't waited for.
    assert count_arrivals(sequence, first, np.zeros(0, np.int64), np.zeros(0, np.int64)).objects == 0


OPTIONS = ScoreOptions()


def write(
    folder: Path, found: Callable[[int], Boxes], poses: bool = True, truth: Callable[[int], Boxes3D] | None = None
) -> Run:
    """A run past an oncoming car; the ego drives 10 m/s."""
    with RunWriter(folder) as writer:
        for k in range(NUM):
            stamp_ns = START_NS + k * 100_000_000
            writer.add_frame(FrameRecord(k, stamp_ns, 0, None, {}, "", ""), {"total": 1})
            writer.add_boxes("detections", k, found(k))
            writer.add_boxes("tracks", k, found(k))
            writer.label_frame(k, Truth(stamp_ns, stamp_ns, (truth or coming)(k), None))
        if poses:
            writer.set_poses(np.array([[k, 0, 0, 0, 0, 0, 1.0] for k in range(NUM)]))
        return Run(writer.finish(make_manifest()))


def coming(k: int) -> Boxes3D:
    """45 m ahead at first, 20 m/s nearer; behind the ego from 2.25 s on."""
    car = boxes3d((45 - 2 * k, 3.5), label="car", ids=[5], score=[0.9])
    return replace(car, yaw_rad=np.array([np.pi]))


def rows(run: Run, event: str = "oncoming") -> dict[str, Score]:
    return {r.metric: r for r in Events().scores(run, OPTIONS) if r.class_ == "vehicle" and r.slice == f"event:{event}"}


def test_slices_of_a_run(tmp_path: Path) -> None:
    def late(k: int) -> Boxes3D:
        return coming(k) if k >= 10 else coming(k)[:0]

    own = rows(write(tmp_path / "run", late))
    assert {name: row.value for name, row in own.items() if name != "hota_temporal"} == {
        "events": 1, "recall": 13 / 23, "clr_re": 13 / 23, "timestamp_balanced_accuracy": (13 / 23 + 1) / 2,
    }  # fmt: skip
    # DetA and AssA are 13 / 23 at all thresholds.
    assert own["hota_temporal"].value == pytest.approx(13 / 23)
    assert own["recall"].counts == {"tp": 13, "fn": 10}
    assert rows(write(tmp_path / "other", late), "cut-in")["events"].value == 0


def test_tracks_on_truth_that_does_not_count_show_no_false_event(tmp_path: Path) -> None:
    """An ignored car comes toward the ego, and a pedestrian crosses, whom tracks without classes follow."""

    def ignored(k: int) -> Boxes3D:
        return replace(coming(k), ignore=np.array([True]))

    def walking(k: int) -> Boxes3D:
        return boxes3d((25 - k, 6 - 0.2 * k), label="pedestrian", ids=[6], score=[0.9])

    def nameless(k: int) -> Boxes3D:
        return replace(walking(k), label=None)

    for folder, event, found, truth in (("a", "oncoming", coming, ignored), ("b", "crossing", nameless, walking)):
        accuracy = rows(write(tmp_path / folder, found, truth=truth), event)["timestamp_balanced_accuracy"]
        assert accuracy.counts == {"tp": 0, "fp": 0, "fn": 0, "tn": NUM}, event
    ghost = rows(write(tmp_path / "ghost", coming, truth=lambda k: coming(k)[:0]))["timestamp_balanced_accuracy"]
    assert ghost.counts["fp"] == 23


def test_one_frame_has_no_motion(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run") as writer:
        writer.add_frame(FrameRecord(0, START_NS, 0, None, {}, "", ""), {"total": 1})
        for table in ("detections", "tracks"):
            writer.add_boxes(table, 0, coming(0))
        writer.label_frame(0, Truth(START_NS, START_NS, coming(0), None))
        writer.set_poses(np.array([[0, 0, 0, 0, 0, 0, 1.0]]))
        own = rows(Run(writer.finish(make_manifest())))
    assert own["events"].reason == "the motion of the ego isn't known: that takes poses at most 1 s apart"


def together(*runs: Run, event: str = "event:oncoming") -> dict[str, Score]:
    """Scores of runs as of several logs."""
    for i, run in enumerate(runs):
        text = (run.folder / "manifest.json").read_text()
        (run.folder / "manifest.json").write_text(text.replace('"log_id": "', f'"log_id": "{i}'))
    measured = [measure_run(Run(run.folder), OPTIONS, metrics=[Events()]) for run in runs]
    return {r.metric: r for r in combine_runs(measured) if r.slice == event and r.class_ == "vehicle"}


def test_runs_together(tmp_path: Path) -> None:
    found = together(write(tmp_path / "one", coming), write(tmp_path / "two", lambda k: coming(k)[:0]))
    assert found["events"].value == 2
    assert found["recall"].value == 0.5
    assert found["hota_temporal"].value == pytest.approx(0.5**0.5)  # DetA is 23 of 46, AssA is 1
    assert found["timestamp_balanced_accuracy"].value == pytest.approx((0.5 + 1) / 2)


def test_what_no_run_knows_stays_unknown_together(tmp_path: Path) -> None:
    lost = [write(tmp_path / name, coming, poses=False) for name in ("lost", "lost too")]
    events = together(*lost)["events"]
    why = "the motion of the ego isn't known: that takes poses at most 1 s apart"
    assert (events.value, events.reason, events.counts) == (None, why, {})
    arrivals = together(*lost, event="all")
    unseen = "truth has neither visibility nor point counts with ids"
    assert [(arrivals[m].value, arrivals[m].reason) for m in ("time_to_track", "never_tracked")] == 2 * [(None, unseen)]
    known = write(tmp_path / "known", coming)
    assert together(*lost, known)["events"].value == 1


def test_null_with_the_reason(tmp_path: Path) -> None:
    own = rows(write(tmp_path / "poses", coming, poses=False))
    assert own["events"].reason == "the motion of the ego isn't known: that takes poses at most 1 s apart"
    nameless = rows(write(tmp_path / "ids", coming, truth=lambda k: replace(coming(k), track_id=None)))
    assert nameless["events"].reason == "truth has no velocities, nor ids to derive them from"
    flat = rows(write(tmp_path / "flat", lambda k: boxes2d((0, 0, 9, 9), label="car")))
    assert flat["events"].value is None
    unseen = {r.metric: r for r in Events().scores(write(tmp_path / "seen", coming), OPTIONS) if r.slice == "all"}
    assert unseen["time_to_track"].reason == "truth has neither visibility nor point counts with ids"


def test_changes_are_not_known_without_ids(tmp_path: Path) -> None:
    def moving(k: int) -> Boxes3D:
        return replace(coming(k), track_id=None, velocity_mps=np.array([[-10.0, 0, 0]]))

    run = write(tmp_path / "run", coming, truth=moving)
    for event in ("cut-in", "hard braking"):
        assert (rows(run, event)["events"].value, rows(run, event)["events"].reason) == (
            None, f"truth has no ids, which {event} takes",
        )  # fmt: skip
    assert rows(run)["events"].value == 23  # Without an id, each box is an event of its own


def test_found_has_every_event() -> None:
    found: Found = find_events(bodies(driving, cutting)[:0], steps(), ego(driving))
    assert tuple(found.rows) == EVENTS
