"""Folders with several calibrations become one log, in which the rig changes; so do real ones."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.datasets.astyx.conftest import OBJECTS
from tests.replay.formats.exports import exported

from fbench.api.replays import replay
from fbench.datasets.astyx import Astyx
from fbench.datasets.importing.run import ImportedLog, import_one
from fbench.replay.check.survey import survey
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, ImportRequest
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import RigChange
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs import open as logs
from fbench.replay.logs.convert.run import ConvertRequest, convert
from fbench.replay.logs.convert.target import Target
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

MS = 1_000_000
"""Frames 7, 8 and 10 of the tiny folder are 100 ms apart."""


def raise_lidar(folder: Path, number: int, by_m: float) -> None:
    path = folder / f"calibration/{number:06d}.json"
    content = json.loads(path.read_text())
    content["sensors"][1]["calib_data"]["T_to_ref_COS"][2][3] += by_m
    path.write_text(json.dumps(content))


@pytest.fixture
def two_rigs(astyx_folder: Path) -> Path:
    """From frame 10 on the LiDAR is 0.5 m higher."""
    raise_lidar(astyx_folder, 10, 0.5)
    return astyx_folder


def imported(folder: Path, skip: bool = False) -> tuple[ImportedLog, BadInput]:
    bad = BadInput(skip=skip)
    return import_one(Astyx(), folder, folder.parent / "out.mcap", ImportRequest((folder.name,), bad=bad)), bad


def test_the_rig_changes_where_the_calibration_does(two_rigs: Path) -> None:
    log, _ = imported(two_rigs)
    assert "calibration changes before frames 10: a new segment begins there" in log.lines
    reader, rig, heights = logs.open_log(log.path, FaultLog()), None, []
    rig = reader.rig
    for event in reader.messages():
        if isinstance(event, RigChange):
            assert event.sensors == ("lidar_vlp16",)
            rig = event.rig
        elif isinstance(event, PointCloud):
            heights.append((event.frame_number, float(rig.body_T_sensor("lidar_vlp16")[2, 3])))
    assert heights == [(7, 3.0), (8, 3.0), (10, 3.5)]


def test_containers_keep_the_rigs_and_info_counts_them(two_rigs: Path) -> None:
    log, _ = imported(two_rigs)
    folder, again = two_rigs.parent / "out.parquet", two_rigs.parent / "again.mcap"
    for source, out in ((log.path, folder), (folder, again)):
        convert(logs.open_container(source, FaultLog()), Target(out), ConvertRequest())
    assert again.read_bytes() == log.path.read_bytes()
    for path in (log.path, folder):
        found = survey(logs.open_log(path, FaultLog()), SyncParams())
        assert found.rig_changes is not None
        assert [change.sensors for change in found.rig_changes] == [("lidar_vlp16",)]
        assert found.breaks == ("calibration of lidar_vlp16 changes before frame 2",)


def test_runs_have_a_segment_for_each_rig(two_rigs: Path) -> None:
    log, _ = imported(two_rigs)
    out = two_rigs.parent / "run"
    run = replay(ReplayRequest(LogRequest(log.path), "lidar3d", out=out)).run
    assert [frame.segment for frame in run.frames] == [0, 0, 1]
    heights = [run.manifest.rig_of(frame.segment).mounts["lidar_vlp16"].translation_m[2] for frame in run.frames]
    assert heights == [3.0, 3.0, 3.5]
    # Points of reports are in body coordinates; the last sweep has one, straight ahead of the LiDAR.
    assert [frame.points["lidar_vlp16"].xyz[0, 2] for frame in run.media] == pytest.approx([3.0, 3.0, 3.5])
    cut = replay(ReplayRequest(LogRequest(log.path), "lidar3d", from_="0.15", out=out, overwrite=True)).run
    assert [frame.segment for frame in cut.frames] == [1]
    assert cut.manifest.rig_of(1).mounts["lidar_vlp16"].translation_m[2] == 3.5


def test_exports_use_the_rig_of_their_frame(astyx_folder: Path) -> None:
    """From frame 8 on the camera is 0.2 m lower, and so the same truth 0.2 m higher in its coordinates."""
    for number in (8, 10):
        path = astyx_folder / f"calibration/{number:06d}.json"
        content = json.loads(path.read_text())
        content["sensors"][2]["calib_data"]["T_to_ref_COS"][2][3] -= 0.2
        path.write_text(json.dumps(content))
    labels = astyx_folder / "groundtruth_obj3d"
    car = {**OBJECTS[0], "center3d": [10.0, 0.2, 0.3]}
    for number in (7, 8):
        (labels / f"{number:06d}.json").write_text(json.dumps({"objects": [car]}))
    log, _ = imported(astyx_folder)
    out = astyx_folder.parent / "kitti"
    exported("kitti", out, log.path, frame="camera_front")
    heights = [float((out / f"00000{n}.txt").read_text().split()[12]) for n in (7, 8)]
    assert heights[1] - heights[0] == pytest.approx(-0.2)


def test_a_frame_without_calibration_has_that_of_its_neighbors_where_they_agree(two_rigs: Path) -> None:
    (two_rigs / "calibration/000008.json").unlink()
    with pytest.raises(LogError, match=r"frame 8 has no calibration, and frames 7 and 10 have different ones"):
        imported(two_rigs)
    raise_lidar(two_rigs, 7, 0.5)
    log, _ = imported(two_rigs)
    reader = logs.open_log(log.path, FaultLog())
    assert [m.frame_number for m in reader.messages() if isinstance(m, PointCloud)] == [7, 8, 10]
    assert not any(isinstance(event, RigChange) for event in reader.messages())
    assert "missing files: camera_front 1, radar_6455 1, calibration 1, groundtruth_obj3d 1" in log.lines


def test_frames_without_usable_calibration_are_skipped(two_rigs: Path) -> None:
    (two_rigs / "calibration/000008.json").write_text("[]")
    with pytest.raises(LogError, match=r"calibration/000008.json: Input should be"):
        imported(two_rigs)
    log, bad = imported(two_rigs, skip=True)
    assert bad.num == 1
    clouds = [m for m in logs.open_log(log.path, FaultLog()).messages() if isinstance(m, PointCloud)]
    assert [cloud.frame_number for cloud in clouds] == [7, 10]


@pytest.mark.parametrize("name", ["calibration/000010.json", "calibration/000008.json"])
def test_calibrations_are_checked_before_any_message_is_written(two_rigs: Path, name: str) -> None:
    (two_rigs / name).write_text("{")
    recording = next(iter(Astyx().recordings(two_rigs, ImportRequest((two_rigs.name,)))))
    with pytest.raises(LogError, match=name):
        assert recording.rig is None


def test_real_frames_of_two_calibrations(shared: Path, tmp_path: Path) -> None:
    source = shared / "data/astyx_more"
    if not source.is_dir():
        pytest.skip(f"real recordings are not at {source}")
    for folder in sorted(path for path in source.iterdir() if path.is_dir()):
        (tmp_path / "set" / folder.name).mkdir(parents=True)
        for path in folder.iterdir():
            if path.stem >= "000455":
                (tmp_path / "set" / folder.name / path.name).symlink_to(path)
    log, _ = imported(tmp_path / "set")
    reader, numbers = logs.open_log(log.path, FaultLog()), []
    for event in reader.messages():
        if isinstance(event, RigChange):
            numbers.append(event.sensors)
        elif isinstance(event, PointCloud):
            numbers.append(event.frame_number)
    assert numbers == [*range(455, 459), ("camera_front", "lidar_vlp16"), *range(500, 509)]
    assert np.isfinite(reader.rig.body_T_sensor("camera_front")).all()
