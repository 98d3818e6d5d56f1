"""Invented scenes with known numbers, and the plain computations that they come from."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.datasets.nuscenes.conftest import token

from fbench.datasets.importing.run import import_one
from fbench.datasets.nuscenes import NuScenes, NuScenesParams
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import FrameRange, ImportRequest
from fbench.replay.contracts.testing import check_importer
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.logs.open import open_log

START_NS = 1_532_402_927_000_000_000
TIMES_S = (0.0, 0.5, 1.0, 1.5, 3.2, 5.0)
MS = 1_000_000
ALL, DEFAULTS = FrameRange(), NuScenesParams()


@dataclass(frozen=True)
class Log:
    summary: list[str]
    info: LogInfo
    rig: Rig
    messages: list[Message | RigChange]
    truths: list[Truth]
    data: bytes

    def of(self, sensor: str) -> list[Message]:
        return [m for m in self.messages if not isinstance(m, RigChange) and m.sensor == sensor]

    def boxes(self, sample: int) -> Boxes3D:
        return next(truth.boxes3d for truth in self.truths if truth.frame_number == sample)


def imported(
    source: Path, name: str = "scene-0001", frames: FrameRange = ALL, params: NuScenesParams = DEFAULTS
) -> Log:
    out = source.parent / "out.mcap"
    lines = import_one(NuScenes(params), source, out, ImportRequest((name,), frames)).lines
    faults = FaultLog()
    reader = open_log(out, faults)
    log = Log(list(lines), reader.info, reader.rig, list(reader.messages()), list(reader.truths()), out.read_bytes())
    assert not faults.counts
    return log


def ms_of(messages: list[Message]) -> list[int]:
    return [(message.stamp_ns - START_NS) // MS for message in messages]


def test_names_are_sorted(nuscenes) -> None:
    nuscenes.rows["scene"].reverse()
    nuscenes.write()
    assert NuScenes().names(nuscenes.root) == ("scene-0001", "scene-0002")


def test_the_folder_with_the_tables_will_do(nuscenes) -> None:
    assert imported(nuscenes.root / "v1.0-mini").data == imported(nuscenes.root).data


def test_metadata(nuscenes) -> None:
    metadata = imported(nuscenes.root).info.metadata
    tokens = [row["token"] for row in nuscenes.rows["sample"][:6]]
    assert metadata["nuscenes.sample_tokens"].split(" ") == tokens
    known = {
        "reference": "LIDAR_TOP", "timeout_ms": "100", "location": "singapore-onenorth", "vehicle": "n015",
        "date": "2018-07-24", "description": "What scene-0001 shows", "nuscenes.version": "v1.0-mini",
        "nuscenes.logfile": "n015-2018-07-24-11-22-45+0800", "import.radar_filter": "True",
        "nuscenes.scene": nuscenes.rows["scene"][0]["token"], "nuscenes.log": nuscenes.rows["log"][0]["token"],
    }  # fmt: skip
    assert {name: metadata[name] for name in known} == known


def test_rig(nuscenes) -> None:
    rig = imported(nuscenes.root).rig
    assert {name: mount.kind for name, mount in rig.mounts.items()} == {
        "CAM_FRONT": "camera", "LIDAR_TOP": "lidar", "RADAR_FRONT": "radar",
    }  # fmt: skip
    # The camera looks forward: its z is the body's x, its x the body's -y.
    assert rig.body_T_sensor("CAM_FRONT") == pytest.approx(
        np.array([[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]), abs=1e-15
    )
    assert rig.body_T_sensor("LIDAR_TOP")[:3, :3] @ [0, 1, 0] == pytest.approx([1, 0, 0])
    camera = rig.cameras["CAM_FRONT"]
    assert camera.size_wh == (8, 6)
    assert camera.K.tolist() == [[8, 0, 4], [0, 9, 3], [0, 0, 1]]


def test_keyframes_and_sweeps(nuscenes) -> None:
    log = imported(nuscenes.root)
    sweeps = log.of("LIDAR_TOP")
    assert ms_of(sweeps) == [-50, 0, 250, 500, 750, 1000, 1250, 1500, 1750, 3200, 3450, 5000, 5250]
    numbers = [None, 0, None, 1, None, 2, None, 3, None, 4, None, 5, None]
    assert [message.frame_number for message in sweeps] == numbers
    for name, offset in (("CAM_FRONT", -30), ("RADAR_FRONT", -20)):
        keys = [m for m in log.of(name) if m.frame_number is not None]
        assert ms_of(keys) == [round(1000 * s) + offset for s in TIMES_S]
        assert [m.frame_number for m in keys] == list(range(6))
        assert len(log.of(name)) == 12
    assert [truth.frame_number for truth in log.truths] == list(range(6))
    assert ms_of(log.truths) == [round(1000 * s) for s in TIMES_S]
    stamps = [message.log_ns for message in log.messages]
    assert stamps == sorted(stamps)
    assert all(message.log_ns == message.stamp_ns for message in log.messages)


def test_content_of_messages(nuscenes) -> None:
    log = imported(nuscenes.root)
    cloud = next(m for m in log.of("LIDAR_TOP") if m.frame_number == 3)
    assert isinstance(cloud, PointCloud)
    assert cloud.xyz.tolist() == [[4, 2, 3], [4, 5, 6]]
    assert cloud.intensity.tolist() == [100, 255]
    assert cloud.ring.tolist() == [7, 31]
    image = next(m for m in log.of("CAM_FRONT") if m.frame_number == 3)
    assert isinstance(image, Image)
    row = next(r for r in nuscenes.rows["sample_data"] if r["timestamp"] * 1000 == image.stamp_ns)
    assert image.data == (nuscenes.root / row["filename"]).read_bytes()


def test_radar_is_measured_along_the_line_of_sight(nuscenes) -> None:
    scan = imported(nuscenes.root).of("RADAR_FRONT")[0]
    assert isinstance(scan, RadarScan)
    assert scan.xyz.tolist() == [[10, 0, 0], [3, 4, 0], [0, -8, 0]]
    # Straight ahead and approaching with 5 m/s; (3 * 1 + 4 * 2) / 5; receding to the right with 4 m/s.
    assert scan.radial_velocity_mps == pytest.approx([-5, 2.2, 4])
    assert scan.rcs_dbsm.tolist() == [7.5, -2, 0]


def test_radar_filter(nuscenes) -> None:
    log = imported(nuscenes.root)
    line = "radar: the filter dropped 36 of 72 echoes; --set radar_filter=false keeps them"
    assert line in log.summary
    log = imported(nuscenes.root, params=NuScenesParams(radar_filter=False))
    assert [len(scan.xyz) for scan in log.of("RADAR_FRONT")] == [6] * 12
    assert not [line for line in log.summary if line.startswith("radar: the")]


def test_poses(nuscenes) -> None:
    log = imported(nuscenes.root)
    poses = log.of("ego")
    stamps = [pose.stamp_ns for pose in poses]
    assert stamps == sorted(set(stamps))
    assert stamps == sorted({m.stamp_ns for m in log.messages if not isinstance(m, Pose)})
    numbered = {pose.frame_number: pose for pose in poses if pose.frame_number is not None}
    assert list(numbered) == list(range(6))
    assert ms_of(list(numbered.values())) == [round(1000 * s) for s in TIMES_S]
    assert numbered[2].translation_m.tolist() == [102, 200, 0]
    turn = Rotation.from_euler("ZYX", [90, 2, 1], degrees=True).as_matrix()
    assert numbered[2].world_T_body[:3, :3] == pytest.approx(turn, abs=1e-12)


def test_of_poses_at_one_instant_that_of_the_lidar_stays(nuscenes) -> None:
    lidar, camera = (nuscenes.row("sample_data", timestamp=START_NS // 1000 + us) for us in (0, -30_000))
    camera["timestamp"] = lidar["timestamp"]
    nuscenes.row("ego_pose", token=camera["ego_pose_token"]).update(timestamp=lidar["timestamp"], translation=[9, 9, 9])
    nuscenes.write()
    poses = [pose for pose in imported(nuscenes.root).of("ego") if pose.frame_number == 0]
    assert [pose.translation_m.tolist() for pose in poses] == [[100, 200, 0]]


def test_boxes_move_into_the_body(nuscenes) -> None:
    log = imported(nuscenes.root)
    boxes = log.boxes(0)
    # The body looks along the world's y: 10 m ahead, 0 m to the left; turned by 120 - 90 degrees.
    assert boxes.center_m == pytest.approx(np.array([[10, 0, 1]]), abs=1e-9)
    assert np.degrees(boxes.yaw_rad) == pytest.approx([30])
    assert boxes.size_lwh_m.tolist() == [[4.5, 1.9, 1.6]]
    boxes = log.boxes(2)
    turn = Rotation.from_euler("ZYX", [90, 2, 1], degrees=True).as_matrix()
    plain = (np.array([[103, 210, 1], [130, 210, 1]]) - [102, 200, 0]) @ turn
    assert boxes.center_m == pytest.approx(plain, abs=1e-9)
    heading = turn.T @ Rotation.from_euler("z", 120, degrees=True).as_matrix()
    own = Rotation.from_euler("ZYX", np.stack([boxes.yaw_rad, boxes.pitch_rad, boxes.roll_rad], 1)).as_matrix()
    assert own == pytest.approx(np.array([heading, heading]), abs=1e-9)


def test_velocities(nuscenes) -> None:
    log = imported(nuscenes.root)

    def along_x(sample: int) -> list[float]:
        turn = Rotation.from_euler("ZYX", [90, 2 * (sample == 2), sample == 2], degrees=True).as_matrix()
        in_world = log.boxes(sample).velocity_mps @ turn.T
        assert np.nan_to_num(in_world[:, 1:]) == pytest.approx(0, abs=1e-9)
        return in_world[:, 0].tolist()

    nan = pytest.approx(np.nan, nan_ok=True)
    # A: one-sided 1 m / 0.5 s at first, then central, at last 3 m / 0.5 s.
    assert along_x(0) == [pytest.approx(2)]
    assert along_x(1) == [pytest.approx(3)]
    # D begins with one-sided 1 m / 0.5 s.
    assert along_x(2) == [pytest.approx(5), pytest.approx(2)]
    # B and C begin before a gap of 1.7 s; D has 4.4 m from 1.0 s to 3.2 s.
    assert along_x(3) == [pytest.approx(6), nan, nan, pytest.approx(2)]
    # B and D end behind the gap; C spans 3.5 s.
    assert along_x(4) == [nan, nan, nan]
    # C ends behind a gap of 1.8 s, E is there once.
    assert along_x(5) == [nan, nan]


def test_columns_of_boxes(nuscenes) -> None:
    boxes = imported(nuscenes.root).boxes(3)
    assert boxes.source_label.tolist() == [
        "vehicle.car", "human.pedestrian.adult", "vehicle.bus.bendy", "static_object.bicycle_rack",
    ]  # fmt: skip
    assert boxes.label.tolist() == ["car", "pedestrian", "bus", "other"]
    assert boxes.ignore.tolist() == [False, False, False, True]
    assert boxes.track_id.tolist() == [1, 3, 4, 2]
    assert boxes.visibility == pytest.approx([0.2, 0.5, 0.7, 0.9])
    assert boxes.attribute.tolist() == ["vehicle.moving", "pedestrian.standing", "vehicle.moving,vehicle.parked", ""]
    assert boxes.num_lidar_pts.tolist() == [3] * 4
    assert boxes.num_radar_pts.tolist() == [6] * 4
    last = imported(nuscenes.root).boxes(5)
    assert last.label.tolist() == ["bus", "other"]
    assert np.isnan(last.visibility[1])


def test_categories_with_plain_names(nuscenes) -> None:
    for row in nuscenes.rows["category"]:
        row["name"] = row["name"].rpartition("vehicle.")[2]
    nuscenes.write()
    boxes = imported(nuscenes.root).boxes(0)
    named = dict(zip(boxes.source_label.tolist(), boxes.label.tolist(), strict=True))
    assert named["car"] == "car"


def test_labeled_samples_without_boxes_and_sets_without_labels(nuscenes) -> None:
    log = imported(nuscenes.root, "scene-0002")
    assert [len(truth.boxes3d) for truth in log.truths] == [0, 0]
    assert [truth.frame_number for truth in log.truths] == [0, 1]
    nuscenes.rows["sample_annotation"] = []
    nuscenes.write()
    log = imported(nuscenes.root, "scene-0002")
    assert not log.truths
    assert log.summary[-1] == "boxes: none, the set isn't labelled"


def test_without_sweeps(nuscenes) -> None:
    log = imported(nuscenes.root, params=NuScenesParams(sweeps=False))
    assert len(log.messages) == 18 + 18
    assert {m.frame_number for m in log.messages if not isinstance(m, Pose)} == set(range(6))
    assert len(log.truths) == 6


def test_ranges_of_samples_share_nothing_and_lack_nothing(nuscenes) -> None:
    whole = imported(nuscenes.root)
    parts = [imported(nuscenes.root, frames=FrameRange(*ends)) for ends in ((0, 2), (2, 5), (5, None))]
    assert [truth.frame_number for part in parts for truth in part.truths] == list(range(6))

    def keys(log: Log) -> list[tuple[str, int, int | None]]:
        return [(m.sensor, m.stamp_ns, m.frame_number) for m in log.messages]

    assert sorted(keys(whole), key=str) == sorted((key for part in parts for key in keys(part)), key=str)
    assert ms_of(parts[0].of("LIDAR_TOP")) == [-50, 0, 250, 500, 750]
    assert ms_of(parts[1].of("CAM_FRONT")) == [970, 1220, 1470, 1720, 3170, 3420]
    # What needs the whole scene is the same: velocities, track ids, tokens.
    assert parts[1].boxes(3).track_id.tolist() == whole.boxes(3).track_id.tolist()
    assert parts[1].boxes(2).velocity_mps.tobytes() == whole.boxes(2).velocity_mps.tobytes()
    assert parts[1].info.metadata["nuscenes.sample_tokens"] == whole.info.metadata["nuscenes.sample_tokens"]


def test_ids_tell_imports_apart(nuscenes) -> None:
    requests: list[Callable[[], Log]] = [
        lambda: imported(nuscenes.root),
        lambda: imported(nuscenes.root, "scene-0002"),
        lambda: imported(nuscenes.root, frames=FrameRange(1)),
        lambda: imported(nuscenes.root, params=NuScenesParams(sweeps=False)),
        lambda: imported(nuscenes.root, params=NuScenesParams(radar_filter=False)),
    ]
    assert len({asked().info.log_id for asked in requests}) == len(requests)


def test_importing_again_gives_the_same_bytes(nuscenes) -> None:
    assert imported(nuscenes.root).data == imported(nuscenes.root).data


def test_the_order_of_rows_doesnt_matter(nuscenes) -> None:
    before = imported(nuscenes.root)
    for name in ("sample", "sample_data", "ego_pose", "calibrated_sensor"):
        nuscenes.rows[name].reverse()
    nuscenes.write()
    assert imported(nuscenes.root).data == before.data


def test_summary(nuscenes) -> None:
    counts = "vehicle.car 4, static_object.bicycle_rack 3, vehicle.bus.bendy 3, human.pedestrian.adult 2, spaceship 1"
    assert imported(nuscenes.root).summary == [
        "scene: What scene-0001 shows",
        "samples: 6 of 6, 5.0 s",
        "camera: 1 (CAM_FRONT), 6 keyframes, 6 sweeps",
        "lidar: 1 (LIDAR_TOP), 6 keyframes, 7 sweeps",
        "radar: 1 (RADAR_FRONT), 6 keyframes, 6 sweeps",
        "poses: 37",
        "samples without a keyframe: none",
        "radar: the filter dropped 36 of 72 echoes; --set radar_filter=false keeps them",
        f"boxes: 13 ({counts}), 5 tracks, 6 with velocity",
        "categories that nuScenes lacks, taken as 'other': spaceship",
    ]


def test_the_importer_keeps_what_its_protocol_promises(nuscenes) -> None:
    check_importer(NuScenes, nuscenes.root)


def _recalibrate(nuscenes, channels: dict[str, int]) -> None:
    """Give sensors another calibration, 1 m farther ahead, from these stamps [ms] on."""
    for channel, from_ms in channels.items():
        old = nuscenes.row("calibrated_sensor", token=token("calibration", channel))
        x, y, z = old["translation"]
        new, moved = token("new", channel), {**old, "translation": [x + 1, y, z]}
        nuscenes.add("calibrated_sensor", new, **{k: v for k, v in moved.items() if k != "token"})
        for row in nuscenes.rows["sample_data"]:
            since_us = row["timestamp"] - START_NS // 1000
            if row["calibrated_sensor_token"] == old["token"] and since_us >= 1000 * from_ms:
                row["calibrated_sensor_token"] = new
    nuscenes.write()


def test_calibrations_that_change_within_a_scene_change_the_rig(nuscenes) -> None:
    """Sensors that change between the same two of their messages change at once, others when they measure again."""
    before = imported(nuscenes.root)
    stamps_ms = {name: ms_of(before.of(name)) for name in ("CAM_FRONT", "LIDAR_TOP", "RADAR_FRONT")}
    _recalibrate(nuscenes, {"CAM_FRONT": 950, "LIDAR_TOP": 950, "RADAR_FRONT": 3000})
    log = imported(nuscenes.root)
    first = min(ms for name in ("CAM_FRONT", "LIDAR_TOP") for ms in stamps_ms[name] if ms >= 950)
    radar = min(ms for ms in stamps_ms["RADAR_FRONT"] if ms >= 3000)
    changes = [event for event in log.messages if isinstance(event, RigChange)]
    assert [((c.log_ns - START_NS) // MS, c.sensors) for c in changes] == [
        (first, ("CAM_FRONT", "LIDAR_TOP")),
        (radar, ("RADAR_FRONT",)),
    ]
    x_m: dict[str, list[float]] = {}
    rig = log.rig
    for event in log.messages:
        if isinstance(event, RigChange):
            rig = event.rig
        elif event.sensor in stamps_ms:
            x_m.setdefault(event.sensor, []).append(rig.mounts[event.sensor].translation_m[0])
    old = {"CAM_FRONT": (1.5, 950), "LIDAR_TOP": (1.0, 950), "RADAR_FRONT": (3.0, 3000)}
    assert x_m == {name: [x + (ms >= at) for ms in stamps_ms[name]] for name, (x, at) in old.items()}
    assert any(line.startswith("calibration changes after ") for line in log.summary)


def test_two_calibrations_at_one_stamp_are_refused(nuscenes) -> None:
    row = nuscenes.row("sample_data", calibrated_sensor_token=token("calibration", "LIDAR_TOP"))
    _recalibrate(nuscenes, {"LIDAR_TOP": 10**9})
    nuscenes.rows["sample_data"].append(
        {**row, "token": "twin", "calibrated_sensor_token": token("new", "LIDAR_TOP"), "is_key_frame": False}
    )
    nuscenes.write()
    with pytest.raises(LogError, match="scene-0001: two calibrations of LIDAR_TOP at one stamp"):
        imported(nuscenes.root)
