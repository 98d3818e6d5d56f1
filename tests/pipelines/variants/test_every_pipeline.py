"""What holds for every pipeline that comes with fbench: no order counts, the world may lie anywhere, and neither odd
points nor a sensor that is away for a while make it fail.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.pipelines.variants.every import (
    CASES,
    LOG,
    STEP_NS,
    Case,
    drive,
    outputs,
    recorded,
    require_sound,
    rig_of,
    weights,
)

from fbench.replay.contracts.entry_points import entry_points_of as plugins_found
from fbench.replay.contracts.plugins import make_pipeline
from fbench.replay.contracts.protocols import UsesSensors
from fbench.replay.contracts.variants import find_variants
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.geometry.transforms import pose_matrix
from fbench.replay.runs.digest import digest


def cases(*kinds: str, but: Sequence[str] = ()) -> pytest.MarkDecorator:
    """Pipelines that use one of these kinds of sensors, but those named."""
    chosen = [case for case in CASES if set(kinds) & set(case.uses) and case.name not in but]
    return pytest.mark.parametrize("case", chosen, ids=str)


every = cases(*"CLRSD")


def test_no_pipeline_is_forgotten():
    elsewhere = {"plain2d", "plain3d", "recorded", "exec"}  # what others are made of, and what detects nothing
    built_in = set(plugins_found("pipelines")) - elsewhere | {variant.name for variant, _ in find_variants()}
    assert {case.name for case in CASES} == built_in


@every
def test_each_finds_something_in_these_frames(case: Case, one_car: Path):
    """So that the other tests compare more than nothing."""
    last = outputs(case, one_car, drive(case, 3))[-1]
    assert len(last.detections) > 0
    assert len(last.tracks) > 0


# Order


def shuffled(frame: Frame, random: np.random.Generator) -> Frame:
    """The same frame, its messages and their points in another order."""
    messages = list(frame.messages.values())
    order = random.permutation(len(messages))
    return replace(frame, messages={m.sensor: _shuffled(m, random) for m in (messages[i] for i in order)})


def _shuffled(message: Message, random: np.random.Generator) -> Message:
    if isinstance(message, PointCloud):
        return replace(message, xyz=message.xyz[random.permutation(len(message.xyz))])
    if isinstance(message, RadarScan):
        rows = random.permutation(len(message.xyz))
        assert message.radial_velocity_mps is not None
        assert message.rcs_dbsm is not None
        return replace(
            message, xyz=message.xyz[rows], radial_velocity_mps=message.radial_velocity_mps[rows],
            rcs_dbsm=message.rcs_dbsm[rows],
        )  # fmt: skip
    return message


@every
def test_no_order_of_sensors_points_and_detections_counts(case: Case, one_car: Path):
    frames, random = drive(case, 3), np.random.default_rng(3)
    results = [replace(r, boxes3d=r.boxes3d[random.permutation(4)]) for r in recorded(frames)]
    expected = outputs(case, one_car, frames)
    again = outputs(case, one_car, [shuffled(frame, random) for frame in frames], results=results)
    for one, other in zip(expected, again, strict=True):
        kinds = ("tracks",) if case.uses == "D" else ("detections", "tracks")  # `track` hands detections on
        for kind in kinds:
            for name, values in getattr(one, kind).arrays().items():
                np.testing.assert_array_equal(getattr(other, kind).arrays()[name], values)


# Sensors that aren't used


def garbled(message: Message) -> Message:
    """Another measurement at the same instant."""
    if isinstance(message, PointCloud | RadarScan):
        return replace(message, xyz=message.xyz[::-1] * np.float32(0.7))
    return replace(message, data=bytes(len(message.data))) if isinstance(message, Image) else message


@cases(*"CLRS")
def test_nothing_depends_on_sensors_that_it_says_it_does_not_use(case: Case, one_car: Path):
    """So that conditions needn't act on them; the rig has all sensors."""
    whole = replace(case, uses="CLRS")
    rig, frames = rig_of(whole), drive(whole, 3)
    pipeline, _ = make_pipeline(case.name, [*case.settings, *weights(case, one_car)])
    pipeline.start(rig, LOG)
    assert isinstance(pipeline, UsesSensors)
    used = pipeline.used_sensors()
    assert (case.name, set(used) < {*rig.mounts}) == (case.name, not case.uses.startswith("CLR"))
    others = [replace(f, messages={n: m if n in used else garbled(m) for n, m in f.messages.items()}) for f in frames]
    expected, found = (outputs(case, one_car, these, rig) for these in (frames, others))
    assert digest([(o.detections, o.tracks) for o in found]) == digest([(o.detections, o.tracks) for o in expected])


# Place


def moved_world(frame: Frame) -> Frame:
    """The same frame; the world's origin is far away, and its axes are turned."""
    world_T_old = pose_matrix(np.array([1200.0, -800.0, 30.0]), Rotation.from_euler("z", 2.1).as_quat())
    pose = frame.messages["pose"]
    assert isinstance(pose, Pose)
    matrix = world_T_old @ pose.world_T_body
    turned = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return replace(
        frame, messages={**frame.messages, "pose": replace(pose, translation_m=matrix[:3, 3], rotation_xyzw=turned)}
    )


@every
def test_a_motion_of_the_world_moves_everything_with_it(case: Case, one_car: Path):
    """Results are in the body's coordinates, or in images, which such a motion leaves alone."""
    frames = drive(case, 4)
    expected = outputs(case, one_car, frames)
    for one, other in zip(expected, outputs(case, one_car, [moved_world(f) for f in frames]), strict=True):
        require_alike(one.detections, other.detections)
        require_alike(one.tracks, other.tracks)


def require_alike(one: Boxes, other: Boxes) -> None:
    """The same boxes but for rounding; headings by their sines, which have no seam."""
    assert len(one) == len(other)
    for name, values in one.arrays().items():
        if values.dtype.kind != "f":
            np.testing.assert_array_equal(other.arrays()[name], values)
        elif name == "yaw_rad":
            np.testing.assert_allclose(np.sin(other.arrays()[name] - values), 0, atol=1e-4)
        else:
            np.testing.assert_allclose(other.arrays()[name], values, rtol=1e-4, atol=1e-3, err_msg=name)


QUARTER = Rotation.from_euler("z", 90, degrees=True)


def turned_rig(rig: Rig) -> Rig:
    """The same sensors, of a body whose x axis points to where -y did."""

    def turned(mount: Mount) -> Mount:
        return Mount(
            mount.kind,
            QUARTER.apply(np.array(mount.translation_m)),
            (QUARTER * Rotation.from_quat(np.array(mount.rotation_xyzw))).as_quat(),
        )

    return Rig({name: turned(mount) for name, mount in rig.mounts.items()}, rig.cameras)


@cases(*"CLRS", but=("radar2d",))  # it takes headings to be along the vehicle's way, so that outlines change
def test_other_axes_of_the_body_turn_the_result(case: Case, one_car: Path):
    """Without poses, as all sensors are turned; what is in images stays. In scores of early2d moving echoes count, and
    what tells them takes vehicles to drive along their x axis: there velocities stay as they are. Networks aren't as
    sure of what they see in every direction: what learned3d is sure of turns.
    """
    more = {"early2d": "radar.doppler.ego_motion=removed", "learned3d": "network.min_score=0.6"}
    if case.name in more:
        case = replace(case, settings=(*case.settings, more[case.name]))
    frames = [replace(f, messages={n: m for n, m in f.messages.items() if n != "pose"}) for f in drive(case, 2)]
    rig = rig_of(case)
    expected, turned = (outputs(case, one_car, frames, sensors)[0].detections for sensors in (rig, turned_rig(rig)))
    assert len(expected) == len(turned) > 0
    if isinstance(expected, Boxes2D) and isinstance(turned, Boxes2D):
        require_alike(expected, turned)
    elif isinstance(expected, Boxes3D) and isinstance(turned, Boxes3D):
        places = QUARTER.apply(np.array(expected.center_m))
        apart = np.linalg.norm(places[:, None] - turned.center_m, axis=2)
        assert apart.min(axis=1).max() < 0.5  # a radar's boxes lie along the way unless they show another heading


# Points


def _everywhere(num: int) -> Float64:
    return np.random.Generator(np.random.Philox(7)).uniform([-60, -60, -2], [60, 60, 4], (num, 3))


ODD: dict[str, Callable[[], Float64]] = {
    "none": lambda: np.zeros((0, 3)), "one": lambda: np.array([[12.0, 1.0, 0.2]]),
    "equal": lambda: np.full((1000, 3), 7.25), "line": lambda: np.linspace([-50, 3, 0], [50, 3, 0], 1000),
    "million": lambda: _everywhere(1_000_000),
}  # fmt: skip


@cases("L", "R")
@pytest.mark.parametrize("kind", [*list(ODD)[:-1], pytest.param("million", marks=pytest.mark.slow)])
def test_odd_clouds(case: Case, kind: str, one_car: Path):
    xyz, frames = ODD[kind]().astype(np.float32), drive(case, 3)
    odd: dict[str, Message] = {
        "lidar": PointCloud("lidar", STEP_NS, STEP_NS, xyz),
        "radar": RadarScan("radar", STEP_NS, STEP_NS, xyz, *np.full((2, len(xyz)), 2.0, np.float32)),
    }  # fmt: skip
    frames[1] = replace(frames[1], messages={n: odd.get(n, m) for n, m in frames[1].messages.items()})
    require_sound(outputs(case, one_car, frames))


# Sensors that are away

SENSORS = {"C": ("cam",), "L": ("lidar",), "R": ("radar",), "S": ("left", "right"), "D": ("results",)}
AWAY = [(case, kind) for case in CASES for kind in dict.fromkeys((*case.uses, case.uses))]


@pytest.mark.parametrize(("case", "kinds"), AWAY, ids=str)
def test_sensors_that_are_away_for_a_second(case: Case, kinds: str, one_car: Path):
    frames, away = drive(case, 14), {name for kind in kinds for name in SENSORS[kind]}
    for index in range(2, 12):
        messages = {name: m for name, m in frames[index].messages.items() if name not in away}
        frames[index] = replace(frames[index], messages=messages, missing=dict.fromkeys(sorted(away), "late"))
    results = [r for r in recorded(frames) if not ("results" in away and 2 * STEP_NS <= r.stamp_ns < 12 * STEP_NS)]
    found = outputs(case, one_car, frames, results=results)
    require_sound(found)
    assert all(len(found[i].detections) > 0 for i in (0, 1, 12, 13))
    if set(kinds) == set(case.uses):
        assert all(len(found[i].detections) == 0 for i in range(2, 12))
