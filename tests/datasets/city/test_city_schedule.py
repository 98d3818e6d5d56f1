from itertools import pairwise

import pytest

from fbench.datasets.city.measure import START_NS, plans
from fbench.datasets.city.rig import CameraSpec, LidarSpec, RadarSpec, RigSpec, thesis_rig

MS = 1_000_000


def of(found, sensor):
    return [slot for plan in found for slot in plan.slots if slot.sensor == sensor]


def test_every_sensor_keeps_its_rate_and_phase():
    rig = RigSpec(
        cameras={"c": CameraSpec(translation_m=(0.0, 0, 1))},
        lidars={"l": LidarSpec(translation_m=(0.0, 0, 2), phase_ms=12.5)},
        radars={"r": RadarSpec(translation_m=(0.0, 0, 1), rate_hz=13.0, phase_ms=3.0)},
    )
    found = list(plans(rig, 2.0, 0))
    stamps = {name: [slot.stamp_ns - START_NS for slot in of(found, name)] for name in "clr"}
    assert stamps["c"] == [k * 100 * MS for k in range(20)]
    assert stamps["l"] == [12_500_000 + k * 50 * MS for k in range(40)]
    assert stamps["r"] == [3 * MS + round(k * 1e9 / 13) for k in range(26)]
    assert [plan.stamp_ns - START_NS for plan in found] == stamps["c"]
    poses = [slot.stamp_ns - START_NS for plan in found for slot in plan.poses]
    assert poses == [k * 10 * MS for k in range(200)]


def test_plans_follow_each_other_without_a_gap():
    found = list(plans(thesis_rig(), 1.0, 0))
    assert found[0].from_ns == START_NS
    assert found[-1].to_ns == START_NS + 1_000_000_000
    assert all(a.to_ns == b.from_ns for a, b in pairwise(found))
    for plan in found:
        assert all(plan.from_ns <= slot.stamp_ns < plan.to_ns for slot in (*plan.slots, *plan.poses))


def test_messages_arrive_later_by_latency_and_jitter():
    rig = RigSpec(radars={"r": RadarSpec(translation_m=(0.0, 0, 1), latency_ms=20.0, jitter_ms=5.0)})
    late_ms = [(slot.log_ns - slot.stamp_ns) / 1e6 for slot in of(plans(rig, 30.0, 0), "r")]
    assert 20 <= min(late_ms) < 20.2
    assert 24.8 < max(late_ms) <= 25
    assert sum(late_ms) / len(late_ms) == pytest.approx(22.5, abs=0.3)


def test_as_many_are_lost_as_the_spec_says():
    rig = RigSpec(radars={"r": RadarSpec(translation_m=(0.0, 0, 1), loss=0.2)})
    found = of(plans(rig, 100.0, 0), "r")
    assert sum(slot.is_lost for slot in found) / len(found) == pytest.approx(0.2, abs=0.04)
    everything = rig.model_copy(update={"radars": {"r": rig.radars["r"].model_copy(update={"loss": 1.0})}})
    assert all(slot.is_lost for slot in of(plans(everything, 1.0, 0), "r"))


def test_arrivals_depend_on_seed_and_sensor_alone():
    alone = RigSpec(lidars={"lidar": thesis_rig().lidars["lidar"]})
    a, b = (of(plans(rig, 1.0, 3), "lidar") for rig in (thesis_rig(), alone))
    assert a == b
    assert a != of(plans(alone, 1.0, 4), "lidar")


def test_a_slow_reference_still_gives_every_message():
    rig = RigSpec(
        cameras={"c": CameraSpec(translation_m=(0.0, 0, 1), rate_hz=0.7, phase_ms=900.0)},
        radars={"r": RadarSpec(translation_m=(0.0, 0, 1))},
    )
    assert len(of(plans(rig, 5.0, 0), "r")) == 100
