"""A constant offset between the clocks of a sensor and the truth is found from what it sees, or nothing is said."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.city_log import write_city_log
from tests.replay.check.logs import MS, START, checked, clean

from fbench.datasets.astyx.importer import Astyx
from fbench.datasets.importing.run import import_one
from fbench.datasets.radiate.importer import Radiate
from fbench.replay.check.findings import Finding
from fbench.replay.check.log_check import CheckOptions, check_log
from fbench.replay.check.truth import TruthClock
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import PointCloud, RadarScan, Truth
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs.open import open_log
from fbench.replay.logs.setup import StampParams

UPRIGHT = np.array([0.0, 0, 0, 1])
SIZE = np.array([4.0, 2.0, 1.5])
EYE = np.array([1.0, 0.0, 1.8])
RIG = Rig({"lidar": Mount("lidar", EYE, UPRIGHT), "radar": Mount("radar", EYE, UPRIGHT)}, {})
SPEED_MPS = 10.0


@pytest.fixture(scope="module")
def demo(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("demo") / "city.mcap"
    write_city_log(path, seconds=8.0, seed=2, world="highway")
    return path


def of_demo(path: Path, **offsets_ms: float) -> list[Finding]:
    offsets = {name: round(ms * MS) for name, ms in offsets_ms.items()}
    options = CheckOptions(SyncParams(reference="radar"), StampParams(offsets_ns=offsets))
    result = check_log(open_log(path, FaultLog()), FaultLog(), options)
    return [f for f in result.findings if f.code == "TIM012"]


@pytest.mark.slow
@pytest.mark.parametrize("offset_ms", [-300, -100, 200])
def test_an_offset_of_the_lidar_is_found(demo, offset_ms):
    """The option adds to the stamps, so what mends them is the option without it."""
    (one,) = of_demo(demo, lidar=offset_ms)
    assert (one.source, one.severity) == ("lidar", "warning")
    assert abs(float(one.text.partition("moved by ")[2].split(" ms")[0]) + offset_ms) <= 20
    assert abs(float(one.advice.partition("try --offset lidar=")[2])) <= 20


@pytest.mark.parametrize("offset_ms", [-200, 300])
def test_an_offset_of_the_reference_can_only_be_that_of_the_truth(demo, offset_ms):
    (one,) = of_demo(demo, radar=offset_ms)
    assert one.source == "radar"
    assert f"moved by {-offset_ms:+d} ms" in one.text or abs(shift_ms(one) + offset_ms) <= 20
    assert "how truth was stamped" in one.advice


@pytest.mark.parametrize("offset_ms", [-30, 0, 30])
def test_nothing_is_said_of_stamps_that_are_right(demo, offset_ms):
    assert of_demo(demo, lidar=offset_ms) == []


def test_offsets_that_nobody_could_tell_are_not_guessed(demo):
    """Beyond half a second nothing is tried, and no other offset may look right instead."""
    assert of_demo(demo, lidar=1500) == []


def shift_ms(found: Finding) -> float:
    return float(found.text.partition("moved by ")[2].split(" ms")[0])


# A world of two parked cars on each side that the vehicle passes, over and over; independent of the demo's.

Cars = Callable[[float], Sequence[tuple[int, float, float]]]


def parked(time_s: float) -> list[tuple[int, float, float]]:
    """Number, x, y [m] of the cars around, in body coordinates."""
    at = SPEED_MPS * time_s
    return [(k, 20.0 * k - at, 4.0 if k % 2 else -4.0) for k in range(int(at // 20) - 1, int(at // 20) + 4)]


def still(time_s: float) -> list[tuple[int, float, float]]:
    return [(1, 10.0, 4.0), (2, 20.0, -4.0)]


def points(cars: Sequence[tuple[int, float, float]], num_road: int = 400) -> np.ndarray:
    """What a LiDAR sees: sides of the cars that face it, and road, in body coordinates."""
    parts = [np.column_stack([np.linspace(-30, 60, num_road), 3 * np.sin(np.arange(num_road)), np.zeros(num_road)])]
    for _, x, y in cars:
        near_x = x - np.sign(x - EYE[0]) * SIZE[0] / 2 if abs(x - EYE[0]) > SIZE[0] / 2 else None
        near_y = y - np.sign(y) * SIZE[1] / 2
        for z in (0.1, 0.6, 0.9, 1.2):
            along = np.linspace(x - SIZE[0] / 2, x + SIZE[0] / 2, 15)
            parts.append(np.column_stack([along, np.full(15, near_y), np.full(15, z)]))
            if near_x is not None:
                across = np.linspace(y - SIZE[1] / 2, y + SIZE[1] / 2, 9)
                parts.append(np.column_stack([np.full(9, near_x), across, np.full(9, z)]))
    return np.concatenate(parts)


def truth(cars: Sequence[tuple[int, float, float]], stamp_ns: int, grow: float = 1.0) -> Truth:
    num = len(cars)
    center = np.array([[x, y, 5.0] for _, x, y in cars])  # heights as wrong as can be
    ids = np.array([k + 10 for k, _, _ in cars])
    return Truth(stamp_ns, stamp_ns, Boxes3D(center, np.tile(SIZE * grow, (num, 1)), np.zeros(num), track_id=ids))


def items(num: int = 60, offset_ms: float = 0.0, cars: Cars = parked, **how: float) -> list[Truth | PointCloud]:
    """Sweeps and truth at 10 Hz, whose stamps are earlier than they should by an offset."""
    result: list[Truth | PointCloud] = []
    for i in range(num):
        stamp_ns, now = START + i * 100 * MS, cars(i / 10)
        xyz = (points(now) - EYE).astype(np.float32)
        result += [PointCloud("lidar", stamp_ns - round(offset_ms * MS), stamp_ns, xyz), truth(now, stamp_ns, **how)]
    return result


def told(everything: Sequence[Truth | PointCloud | RadarScan]) -> list[Finding]:
    clock = TruthClock()
    for item in everything:
        if isinstance(item, Truth):
            clock.add_truth(item)
        else:
            clock.add_sweep(item, RIG)
    return list(clock.findings({}, "radar"))


@pytest.mark.parametrize("offset_ms", [-250, 120, 300])
def test_parked_cars_tell_it_while_the_vehicle_drives_by(offset_ms):
    (one,) = told(items(offset_ms=offset_ms))
    assert shift_ms(one) == pytest.approx(offset_ms, abs=20)
    assert one.advice == f"try --offset lidar={shift_ms(one):.0f}"


@pytest.mark.parametrize("grow", [0.9, 1.0, 1.2, 1.4])
def test_boxes_of_a_wrong_size_are_no_offset(grow):
    assert told(items(grow=grow)) == []


def test_without_motion_nothing_is_known():
    assert told(items(cars=still, offset_ms=300)) == []


def test_one_track_alone_is_not_believed():
    assert told(items(cars=lambda t: parked(t)[2:3] if t < 1 else [(1, 40 - SPEED_MPS * t, 4.0)], offset_ms=300)) == []


def test_empty_sweeps_and_truth_without_boxes_say_nothing():
    nothing = np.zeros((0, 3), np.float32)
    empty = [replace(m, xyz=nothing) if isinstance(m, PointCloud) else m for m in items(offset_ms=300)]
    assert told(empty) == []
    assert told([m if isinstance(m, PointCloud) else replace(m, boxes3d=Boxes3D.empty()) for m in items()]) == []


def without_ids(item: Truth | PointCloud, **fields: object) -> Truth | PointCloud:
    return replace(item, boxes3d=replace(item.boxes3d, **fields)) if isinstance(item, Truth) else item


def test_boxes_without_ids_say_nothing():
    assert told([without_ids(m, track_id=None) for m in items(offset_ms=300)]) == []
    unknown = [without_ids(m, track_id=np.full(len(m.boxes3d), -1)) if isinstance(m, Truth) else m
               for m in items(offset_ms=300)]  # fmt: skip
    assert told(unknown) == []


def test_boxes_that_are_not_finite_or_have_no_size_are_left_out():
    bad = [
        without_ids(m, center_m=np.where(m.boxes3d.track_id[:, None] % 3 == 0, np.nan, m.boxes3d.center_m))
        if isinstance(m, Truth)
        else m
        for m in items(offset_ms=300)
    ]
    assert [shift_ms(one) for one in told(bad)] == [pytest.approx(300, abs=20)]
    assert told([without_ids(m, size_lwh_m=np.zeros((len(m.boxes3d), 3))) if isinstance(m, Truth) else m
                 for m in items(offset_ms=300)]) == []  # fmt: skip


def test_it_does_not_matter_whether_truth_comes_first_or_last():
    every = items(num=300, offset_ms=200)
    truths, sweeps = [m for m in every if isinstance(m, Truth)], [m for m in every if isinstance(m, PointCloud)]
    assert told([*truths, *sweeps]) == told([*sweeps, *truths]) == told(every)
    assert len(told(every)) == 1


@pytest.mark.slow
def test_what_is_kept_of_long_logs_is_bounded():
    (one,) = told(items(num=3000, offset_ms=300))
    assert shift_ms(one) == pytest.approx(300, abs=20)
    assert one.count <= 160


def test_headings_that_turn_round_between_labels_are_one_footprint():
    def turned(item: Truth | PointCloud) -> Truth | PointCloud:
        if not isinstance(item, Truth) or item.boxes3d is None:
            return item
        flip = item.stamp_ns // (100 * MS) % 2
        return replace(item, boxes3d=replace(item.boxes3d, yaw_rad=np.full(len(item.boxes3d), np.pi * flip)))

    assert [shift_ms(one) for one in told([turned(m) for m in items(offset_ms=200)])] == [pytest.approx(200, abs=20)]


def test_a_radar_is_judged_too():
    scans = [
        RadarScan("radar", m.stamp_ns, m.log_ns, m.xyz[m.xyz[:, 2] > -1.7]) if isinstance(m, PointCloud) else m
        for m in items(offset_ms=300)
    ]
    (one,) = told(scans)
    assert (one.source, shift_ms(one)) == ("radar", pytest.approx(300, abs=20))


def test_points_that_are_not_finite_do_no_harm():
    spoiled = [
        replace(m, xyz=np.concatenate([m.xyz, np.full((3, 3), np.nan, np.float32), [[9e30, 0, 0]]]).astype(np.float32))
        if isinstance(m, PointCloud)
        else m
        for m in items(offset_ms=300)
    ]
    assert [shift_ms(one) for one in told(spoiled)] == [pytest.approx(300, abs=20)]


def test_a_sensor_without_mounting_is_left_out():
    clock = TruthClock()
    for item in items(offset_ms=300):
        clock.add_truth(item) if isinstance(item, Truth) else clock.add_sweep(item, Rig({}, {}))
    assert list(clock.findings({}, None)) == []


def test_plain_logs_have_no_such_finding(tmp_path):
    assert "TIM012" not in [f.code for f in checked(tmp_path / "log.mcap", clean()).findings]


@pytest.mark.slow
def test_real_data_without_tracks_say_nothing(shared, tmp_path):
    import_one(Astyx(), shared / "data" / "astyx", tmp_path / "a.mcap")
    assert "TIM012" not in [f.code for f in checked(tmp_path / "a.mcap").findings]


def test_the_real_offset_of_a_recording_is_found(shared, tmp_path):
    """Its authors' stamps are of different computers; by hand the LiDAR's were found 0.3 s early."""
    log = tmp_path / "fog.mcap"
    import_one(Radiate(), shared / "data" / "radiate_tiny_foggy", log)
    (one,) = [f for f in checked(log).findings if f.code == "TIM012"]
    assert one.source == "velo_lidar"
    assert shift_ms(one) == pytest.approx(300, abs=100)
    mended = checked(log, stamps=StampParams(offsets_ns={"velo_lidar": 300 * MS}))
    assert "TIM012" not in [f.code for f in mended.findings]
