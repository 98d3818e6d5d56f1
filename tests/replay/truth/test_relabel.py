"""Giving runs other truth: from files in body coordinates, in the world, and by frame."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.replay.fakes import MS, UPRIGHT, Echo, cloud, drive

from fbench.replay.contracts.errors import LogError, MetricError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Pose
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log
from fbench.replay.logs.setup import BoxSource, StampParams
from fbench.replay.runs.folder import Run
from fbench.replay.truth.relabel import relabel

SOLID = "x,y,z,length,width,height,yaw"
TURNED = np.array([0.0, 0, np.sqrt(0.5), np.sqrt(0.5)])


def run_of(folder, log=None, **plan):
    replay(log or drive(), Plan(Echo(), "echo", **plan), folder / "run", FaultLog())
    return Run(folder / "run")


def with_poses(log):
    """The body drives to the north, its x axis being the world's y, a meter a frame."""
    poses = [Pose("ego", 100 * MS * i, 100 * MS * i, np.array([100.0, i, 0]), TURNED) for i in range(20)]
    return replace(log, items=[*log.items, *poses])


def labeled(run, text, name="truth.csv", **source):
    (run.folder.parent / name).write_text(text)
    found = relabel(run, BoxSource(run.folder.parent / name, **source))
    return found, Run(run.folder)


def counts(run):
    return {row["code"]: row["count"] for row in run.json("faults.json")["rows"] if row["count"]}


def test_truth_is_replaced(tmp_path):
    run = run_of(tmp_path)
    assert run.manifest.truth is None
    before = json.loads(run.manifest.model_dump_json())
    rows = "".join(f"{100 * MS * i},{i},1,0.5,4,2,1.5,0,Van\n" for i in (1, 3, 25))
    found, after = labeled(run, f"stamp_ns,{SOLID},label\n{rows}")
    assert (found.num_truths, found.num_matched) == (3, 2)
    assert [f.index for f in after.frames if f.truth_stamp_ns is not None] == [1, 3]
    assert after.truth3d(3).center_m.tolist() == [[3, 1, 0.5]]
    assert after.truth3d(3).label.tolist() == ["van"]
    assert after.truth3d(0) is None
    assert counts(after) == {"GT006": 1}
    entry = after.manifest.truth
    assert (entry.name, entry.format, len(entry.digest)) == ("truth.csv", "table", 32)
    now = json.loads(after.manifest.model_dump_json())
    assert {key for key in now if now[key] != before[key]} == {"truth"}
    assert not list(after.folder.glob(".*"))


def test_boxes_in_a_coordinate_frame_that_moves_are_refused(tmp_path):
    low, high = (Rig({"lidar": Mount("lidar", np.array([0, 0, z]), UPRIGHT)}, {}) for z in (2.0, 3.0))
    with McapWriter(tmp_path / "a.mcap", LogInfo("a", log_id="a-1"), low) as log:
        for number in range(6):
            if number == 3:
                log.write_rig(number * 100 * MS, high)
            log.write(cloud(number * 100 * MS))
    run = run_of(tmp_path, open_log(tmp_path / "a.mcap", FaultLog()))
    assert len(run.manifest.rig_changes) == 1
    text = f"frame,{SOLID}\n0,1,1,0.5,4,2,1.5,0\n"
    with pytest.raises(LogError, match=r"truth\.csv.*: boxes in 'lidar', which moves on the body within the log"):
        labeled(run, text, frame="lidar")
    found, _ = labeled(run, text, frame="body")
    assert found.num_matched == 1


def test_truth_named_twice_differs_by_frame_and_classes(tmp_path):
    text, entries = f"frame,{SOLID},label\n0,1,1,0.5,4,2,1.5,0,bus\n", []
    for frame, classes in (("body", None), ("world", None), ("body", {"bus": "truck"})):
        run = run_of(tmp_path / str(len(entries)), with_poses(drive()))
        (tmp_path / "truth.csv").write_text(text)
        relabel(run, BoxSource(tmp_path / "truth.csv", frame=frame), classes)
        entries.append(Run(run.folder).manifest.truth)
    assert [(entry.frame, bool(entry.classes)) for entry in entries] == [
        ("body", False),
        ("world", False),
        ("body", True),
    ]
    assert len({entry.digest for entry in entries}) == 1


def test_truth_between_is_that_of_a_replay(tmp_path):
    """Labelled every 250 ms, with poses: frames 0 and 5 and so on are labeled, others lie between."""
    log = with_poses(drive())
    labels = [replace(t, stamp_ns=250 * MS * i, boxes3d=replace(t.boxes3d, velocity_mps=np.array([[1.0, 2, 0]])))
              for i, t in enumerate(log.labels[:7])]  # fmt: skip
    whole = run_of(tmp_path / "whole", replace(log, labels=labels), max_between_ns=250 * MS)
    run = run_of(tmp_path, log)
    rows = "".join(f"{t.stamp_ns},{t.boxes3d.center_m[0, 0]},0,0,4,2,1.5,0,7,1,2\n" for t in labels)
    (tmp_path / "truth.csv").write_text(f"stamp_ns,{SOLID},track_id,vx,vy\n{rows}")
    found = relabel(run, BoxSource(tmp_path / "truth.csv"), max_between_ns=250 * MS)
    assert (found.num_truths, found.num_matched, found.num_between) == (7, 16, 12)
    after = Run(run.folder)
    assert after.manifest.interpolation == whole.manifest.interpolation
    assert counts(after).get("GT006") is None
    for index in range(16):
        a, b = whole.truth3d(index), after.truth3d(index)
        for name in ("center_m", "yaw_rad", "velocity_mps"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert after.truth3d(16) is None
    again = relabel(after, BoxSource(tmp_path / "truth.csv"))
    assert (again.num_matched, again.num_between) == (4, 0)
    assert counts(Run(run.folder)) == {"GT006": 3}


def test_truth_of_another_kind_removes_the_old(tmp_path):
    rig = Rig({**drive().rig.mounts, "cam": Mount("camera", np.zeros(3), UPRIGHT)}, {})
    run = run_of(tmp_path, replace(drive(), rig=rig))
    _, after = labeled(run, "frame,left,top,right,bottom\n4,1,2,3,4\n")
    assert not (after.folder / "truth.parquet").exists()
    assert after.truth2d(4).xyxy_px.tolist() == [[1, 2, 3, 4]]
    assert [f.truth_spaces for f in after.frames if f.truth_spaces] == ["2d"]


def test_world_truth_is_moved_by_the_poses_of_the_frames(tmp_path):
    """At frame 4 the body is at (100, 4): what is 10 m north of it is 10 m ahead."""
    run = run_of(tmp_path, with_poses(drive()))
    np.testing.assert_allclose(run.poses[4], [100, 4, 0, *TURNED])
    text = f"stamp_s,frame_id,{SOLID},vx,vy\n0.4,world,99,14,0.5,4,2,1.5,{np.pi / 2},0,3\n"
    _, after = labeled(run, text)
    boxes = after.truth3d(4)
    np.testing.assert_allclose(boxes.center_m, [[10, 1, 0.5]], atol=1e-9)
    np.testing.assert_allclose(boxes.yaw_rad, [0], atol=1e-9)
    np.testing.assert_allclose(boxes.velocity_mps, [[3, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(after.poses, run.poses)


def test_replay_moves_world_truth_likewise(tmp_path):
    log = with_poses(drive())
    labels = [replace(truth, in_world=True) for truth in log.labels]
    run = run_of(tmp_path, replace(log, labels=labels))
    # The labeled car is at (10 + i, 0) in the world; the body at (100, i) looks north.
    np.testing.assert_allclose(run.truth3d(4).center_m, [[-4, 86, 0]], atol=1e-9)
    with pytest.raises(LogError, match="truth is in world coordinates, but the log has no poses"):
        run_of(tmp_path / "none", replace(drive(), labels=labels))


def test_world_truth_without_poses_is_refused(tmp_path):
    run = run_of(tmp_path)
    assert np.isnan(run.poses).all()
    before = (run.folder / "frames.parquet").read_bytes()
    with pytest.raises(LogError, match="truth is in world coordinates, but the log has no poses"):
        labeled(run, f"stamp_s,frame_id,{SOLID}\n0.4,world,99,14,0.5,4,2,1.5,0\n")
    assert (run.folder / "frames.parquet").read_bytes() == before
    assert not list(run.folder.glob(".*"))


def test_frames_without_a_pose_alone_arent_labeled(tmp_path):
    log = with_poses(drive())
    kept = [m for m in log.items if not (isinstance(m, Pose) and m.stamp_ns < 300 * MS)]
    run = run_of(tmp_path, replace(log, items=kept))
    text = f"frame,frame_id,{SOLID}\n0,world,99,14,0.5,4,2,1.5,0\n5,world,99,14,0.5,4,2,1.5,0\n"
    found, after = labeled(run, text)
    assert (found.num_truths, found.num_matched, counts(after)) == (2, 1, {"GT006": 1})


def test_what_fits_nowhere_shows_both_ranges(tmp_path):
    run = run_of(tmp_path)
    with pytest.raises(MetricError, match=r"none of its 1 instants, 9000000000 to 9000000000 ns, belongs to a frame"):
        labeled(run, f"stamp_s,{SOLID}\n9,1,2,3,4,2,1,0\n")
    with pytest.raises(MetricError, match="none of its 1 frames, 77 to 77, is in the run, which has 0 to 19"):
        labeled(run, f"frame,{SOLID}\n77,1,2,3,4,2,1,0\n")
    with pytest.raises(MetricError, match="no boxes in it"):
        labeled(run, f"frame,{SOLID}\n")


def test_boxes_that_arent_real_are_counted_by_class(tmp_path):
    run = run_of(tmp_path)
    text = (
        f"frame,{SOLID},label\n0,1,2,3,4,0,1,0,car\n0,1,2,3,4,-2,1,0,car\n0,1,2,3,4,nan,1,0,van\n0,1,2,3,4,2,1,0,bus\n"
    )
    _, after = labeled(run, text)
    assert after.truth3d(0).label.tolist() == ["bus"]
    assert counts(after) == {"GT004": 3}
    assert after.json("faults.json")["lost"] == 3
    assert not after.manifest.complete
    places = next(row["places"] for row in after.json("faults.json")["rows"] if row["code"] == "GT004")
    assert places == ["frame 0: 2 of class 'car'", "frame 0: 1 of class 'van'"]
    _, good = labeled(after, f"frame,{SOLID},label\n0,1,2,3,4,2,1,0,bus\n")
    assert good.manifest.complete


def test_classes_that_arent_known_are_told_and_may_be_mapped(tmp_path):
    run = run_of(tmp_path)
    text = f"frame,{SOLID},label\n0,1,2,3,4,2,1,0,Kfz\n"
    _, after = labeled(run, text)
    assert (after.truth3d(0).label.tolist(), counts(after)) == (["other"], {"GT007": 1})
    relabel(after, BoxSource(tmp_path / "truth.csv"), {"Kfz": "car"})
    assert Run(run.folder).truth3d(0).label.tolist() == ["car"]


def test_truth_refers_to_stamps_as_recorded(tmp_path):
    run = run_of(tmp_path, stamps=StampParams(offsets_ns={"lidar": 30 * MS}), sync=SyncParams(reference="lidar"))
    assert run.frames[2].stamp_ns == 230 * MS
    _, after = labeled(run, f"stamp_s,{SOLID}\n0.2,1,2,3,4,2,1,0\n")
    assert [f.index for f in after.frames if f.truth_spaces] == [2]


def test_a_part_of_a_log_ignores_what_is_outside(tmp_path):
    run = run_of(tmp_path, excerpt=Excerpt(first=5, stop=10))
    rows = "".join(f"{i},{i},1,0.5,4,2,1.5,0\n" for i in range(25))
    found, after = labeled(run, f"frame,{SOLID}\n{rows}")
    assert (found.num_truths, found.num_matched, counts(after)) == (25, 5, {})
    assert after.truth3d(7).center_m[0, 0] == 7
