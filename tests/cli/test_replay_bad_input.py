"""`fbench replay` of what it can't use, or not wholly: one clear line, the exit code of the docs, and nothing left."""

import errno
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import MS, messages, rig, truths, write_log
from tests.cli.test_replay import files, still

from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.data.rig import Rig

__all__ = ["still"]


def fails(result, code, *parts):
    assert result.code == code
    assert result.err.startswith("fbench: ")
    assert result.err.count("\n") == 1
    for part in parts:
        assert part in result.err


def test_file_that_is_no_mcap(fbench, tmp_path):
    path = tmp_path / "notes.mcap"
    path.write_text("just text")
    fails(fbench("replay", path, "-p", "lidar3d"), 3, "notes.mcap", "not a log")
    fails(fbench("replay", tmp_path / "absent.mcap", "-p", "lidar3d"), 3, "absent.mcap")
    assert not Path("runs").exists() or not list(Path("runs").iterdir())


def test_truncated_log_gives_a_run_that_says_so(fbench, log, still):
    data = log.read_bytes()
    log.write_bytes(data[: len(data) // 2])
    result = fbench("replay", log, "-p", still())
    if result.code == 4:  # at least one chunk was whole
        assert "LOG002" in result.out
        assert "INCOMPLETE" in result.out
    else:
        fails(result, 3, "car")


def test_no_calibration(fbench, tmp_path):
    no_lidar_mount = Rig({k: m for k, m in rig().mounts.items() if k != "lidar"}, rig().cameras)
    log = write_log(tmp_path / "bare.mcap", messages(), no_lidar_mount)
    fails(fbench("replay", log, "-p", "lidar3d"), 3, "lidar")


@pytest.mark.parametrize(("pipeline", "kind"), [("lidar3d", "LiDAR"), ("radar3d", "radar")])
def test_missing_sensor(fbench, tmp_path, pipeline, kind):
    camera_only = Rig({"camera": rig().mounts["camera"]}, rig().cameras)
    log = write_log(tmp_path / "camera.mcap", [m for m in messages() if isinstance(m, Image)], camera_only)
    fails(fbench("replay", log, "-p", pipeline), 3, pipeline, kind, "camera")


def test_sensor_without_messages_is_missing_in_every_frame(fbench, tmp_path):
    log = write_log(tmp_path / "deaf.mcap", [m for m in messages() if m.sensor != "radar"])
    result = fbench("replay", log, "-p", "late3d")
    assert result.code == 0
    assert "missing: radar (never came) in 6 frames" in result.out


def test_nan_points_and_empty_clouds(fbench, tmp_path, still):
    items = list(messages())
    clouds = [i for i, m in enumerate(items) if isinstance(m, PointCloud)]
    some_nan = items[clouds[0]].xyz.copy()
    some_nan[-5:] = np.nan
    items[clouds[0]] = replace(items[clouds[0]], xyz=some_nan)
    items[clouds[1]] = replace(items[clouds[1]], xyz=np.full((10, 3), np.nan, np.float32))
    items[clouds[2]] = replace(items[clouds[2]], xyz=np.zeros((0, 3), np.float32))
    log = write_log(tmp_path / "holes.mcap", items)
    result = fbench("replay", log, "-p", "lidar3d")
    assert result.code == 4
    for code in ("DAT004", "DAT001", "DAT002"):
        assert code in result.out
    assert fbench("replay", log, "-p", "lidar3d", "--on-fault", "tolerant", "-o", "again").code == 0


def test_weights_that_are_no_onnx(fbench, log, tmp_path):
    weights = tmp_path / "net.onnx"
    weights.write_bytes(b"\x80\x04pickle")
    for pipeline in ("camera2d", "late3d"):
        fails(fbench("replay", log, "-p", pipeline, "--set", f"camera.weights={weights}"), 3, "net.onnx")
        fails(fbench("replay", log, "-p", pipeline, "--set", "camera.weights=absent.onnx"), 2, "absent.onnx")


def test_camera_without_weights(fbench, log):
    fails(fbench("replay", log, "-p", "camera2d"), 2, "camera2d", "--set camera.weights=")
    result = fbench("replay", log, "-p", "late3d")
    assert result.code == 0
    assert "no weights" in result.out


def test_unknown_names(fbench, log):
    fails(fbench("replay", log, "-p", "lidar"), 2, "unknown pipeline 'lidar'", "did you mean 'lidar")
    fails(
        fbench("replay", log, "-p", "lidar3d", "--set", "lidar.cluster.eps=1"), 2, "did you mean 'lidar.cluster.eps_m'"
    )
    fails(fbench("replay", log, "-p", "lidar3d", "--set", "lidar.cluster.eps_m=big"), 2, "expected float")
    fails(fbench("replay", log, "-p", "lidar3d", "--rate", "0"), 2, "--rate 0")
    fails(fbench("replay", log, "-p", "lidar3d", "--on-fault", "pray"), 2, "--on-fault pray")
    fails(fbench("replay", log, "-p", "lidar3d", "--reference", "sonar"), 2, "reference sensor 'sonar'")
    fails(fbench("log", "import", "astix", ".", "-o", "x.mcap"), 2, "did you mean 'astyx'")


@pytest.mark.slow
def test_output_that_exists_or_cannot_be_written(fbench, log, still, tmp_path):
    fbench("replay", log, "-p", still(), "-o", "run")
    before = files(Path("run"))
    fails(fbench("replay", log, "-p", still(), "-o", "run"), 2, "run: exists already", "--overwrite")
    assert files(Path("run")) == before
    assert fbench("replay", log, "-p", still(), "-o", "run", "--overwrite").code == 0
    (tmp_path / "file").touch()
    fails(fbench("replay", log, "-p", still(), "-o", "file/run"), 2, "can't be written")
    fails(fbench("report", "run", "-o", "file/page.html"), 2, "file/page.html")


def test_folders_that_are_no_runs(fbench, tmp_path):
    fails(fbench("score", "absent"), 2, "absent: no such run folder")
    fails(fbench("report", tmp_path), 3, "not a run folder")
    fails(fbench("compare", tmp_path, tmp_path), 3, "not a run folder")


def test_usage_errors_are_one_line(fbench, log):
    fails(fbench("replay", log), 2, "--pipeline")
    fails(fbench("frobnicate"), 2, "frobnicate")
    fails(fbench("replay", log, "-p", "lidar3d", "--iou", "2"), 2, "--iou")
    fails(fbench("replay", log, "-p", "lidar3d", "--frames"), 2, "--frames")


def test_infinite_durations_are_no_limit(fbench, log, still):
    limits = ("--timeout-ms", "inf", "--tolerance-ms", "inf", "--max-gap-s", "inf")
    assert fbench("replay", log, "-p", still(), *limits).code == 0


def test_pipelines_that_exit_or_print(fbench, log, still, tmp_path):
    file = tmp_path / "bad.py"
    file.write_text("import sys\nsys.exit(0)\n")
    fails(fbench("replay", log, "-p", f"{file}:Bad"), 2, "bad.py: can't be imported: SystemExit")
    path = Path(still().rpartition(":")[0])
    path.write_text(
        path.read_text().replace("def reset", "def reset").replace("self.x = 0.0", "self.x = 0.0; print('hello')")
    )
    result = fbench("replay", log, "-p", f"{path}:Still", "--json")
    assert result.json()["scores"][0]["value"] == 1.0
    assert "hello" in result.err


def test_failing_pipelines_can_be_debugged(fbench, log, still, monkeypatch):
    path = Path(still().rpartition(":")[0])
    path.write_text(
        path.read_text().replace("xyz = frame", 'if frame.index == 2: raise ValueError("odd")\n        xyz = frame')
    )
    result = fbench("replay", log, "-p", f"{path}:Still")
    assert result.code == 4
    assert "frame 2: ValueError: odd (still.py:" in result.out
    assert fbench("--version").out.strip() == "0.1.0"


@pytest.mark.slow
def test_debug_shows_the_traceback_of_the_first_failure(log, still, tmp_path):
    path = Path(still().rpartition(":")[0])
    path.write_text(
        path.read_text().replace("xyz = frame", 'if frame.index > 2: raise ValueError("odd")\n        xyz = frame')
    )
    command = [
        sys.executable,
        "-c",
        "from fbench.cli import main; main()",
        "replay",
        str(log),
        "-p",
        f"{path}:Still",
    ]
    result = subprocess.run([*command, "--debug"], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 4
    assert result.stderr.count("Traceback") == 1
    assert "still.py" in result.stderr


def test_compare_of_runs_without_truth_is_no_pass(fbench, tmp_path, still):
    log = write_log(tmp_path / "blind.mcap", messages())
    fbench("replay", log, "-p", still(), "-o", "run")
    advice = "fbench score RUN --truth FILE adds truth to a run"
    fails(fbench("compare", "run", "run"), 3, f"base has no value of f1 or mota (no truth); {advice}")
    fails(fbench("compare", "run", "run", "--json"), 3, advice)


def test_compare_names_the_parameter_that_differs(fbench, log):
    fbench("replay", log, "-p", "lidar3d", "-o", "a")
    fbench("replay", log, "-p", "lidar3d", "-o", "b", "--set", "lidar.cluster.eps_m=0.7")
    notes = [line for line in fbench("compare", "a", "b").out.splitlines() if line.startswith("note")]
    assert notes == ["note: lidar.cluster.eps_m: 0.6 -> 0.7"]


def test_disk_that_is_full(fbench, log, still, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device", "runs/x")

    monkeypatch.setattr("fbench.replay.runs.folder.save_manifest", full)
    fails(fbench("replay", log, "-p", still()), 3, "runs/x: No space left on device")
    assert list(Path("runs").iterdir()) == []


@pytest.mark.slow
def test_termination_leaves_nothing_behind(log, still, tmp_path):
    command = [sys.executable, "-c", "from fbench.cli import main; main()"]
    arguments = ["replay", str(log), "-p", still(), "-o", str(tmp_path / "runs" / "run"), "--rate", "0.01"]
    process = subprocess.Popen([*command, *arguments], stderr=subprocess.PIPE)
    while not list(tmp_path.glob("runs/.run.partial")):
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 128 + signal.SIGTERM
    assert b"Traceback" not in err
    assert list((tmp_path / "runs").iterdir()) == []


def test_camera_with_unknown_distortion_is_left_out_of_the_score(fbench, tmp_path, still):
    straight = rig()
    bent = replace(straight.cameras["camera"], distortion_model="omni", distortion=np.full(5, 0.1))
    log = write_log(tmp_path / "bent.mcap", [*messages(), *truths()], Rig(straight.mounts, {"camera": bent}))
    result = fbench("replay", log, "-p", still(), "--json")
    assert result.code == 0
    scores = result.json()["scores"]
    assert scores[0]["value"] == 1.0
    assert {s["reason"] for s in scores if s["matching"].startswith("iou")} == {
        "lens distortion of 'camera' isn't modeled"
    }


def test_truth_that_belongs_to_no_frame_is_counted(fbench, tmp_path, still):
    late = [replace(t, stamp_ns=t.stamp_ns + 11_000_000) for t in truths()]
    log = write_log(tmp_path / "off.mcap", [*messages(), *late])
    result = fbench("replay", log, "-p", still())
    assert result.code == 0
    assert "GT006 truth that belongs to no frame: 6" in result.out
    fails(fbench("score", "runs/off-still-Still"), 3, "none of its 6 truths belongs to a frame")


def test_corrupt_image_is_a_fault_of_its_frame(fbench, tmp_path, shared):
    items = list(messages())
    images = [i for i, m in enumerate(items) if isinstance(m, Image)]
    items[images[2]] = replace(items[images[2]], data=items[images[2]].data[:100])
    log = write_log(tmp_path / "torn.mcap", items)
    weights = shared / "weights" / "yolox_nano" / "yolox_nano.onnx"
    result = fbench("replay", log, "-p", "camera2d", "--set", f"camera.weights={weights}")
    assert result.code == 4
    assert "DEC002" in result.out
    assert "INCOMPLETE" in result.out


@pytest.mark.slow
def test_debug_keeps_the_exit_code(tmp_path):
    command = [str(Path(sys.executable).parent / "fbench"), "--debug", "replay"]
    for arguments, code in ((["none.mcap", "-p", "lidar3d"], 3), (["none.mcap", "-p", "lidar4d"], 2)):
        result = subprocess.run([*command, *arguments], cwd=tmp_path, capture_output=True, text=True)
        assert result.returncode == code
        assert "Traceback" in result.stderr
        assert result.stderr.splitlines()[-1].startswith("fbench: ")


def test_a_needed_sensor_in_hardly_any_frame_is_a_loss_that_a_check_says_first(fbench, tmp_path):
    late = [replace(m, log_ns=m.log_ns + 400 * MS) if isinstance(m, PointCloud) else m for m in messages()]
    log = write_log(tmp_path / "late.mcap", [*late, *truths()], metadata={"reference": "radar"})
    said = fbench("log", "check", log)
    line = "is in 0 of 6 frames, although 6 messages of it came: 6 frames were released 369.0 ms too soon for it"
    assert said.code == 1
    assert f"error FRM001 lidar: {line}\n    → --timeout-ms 399 would wait for all of them" in said.out
    for pipeline in ("lidar3d", "early3d", "thesis/lidar3d"):
        result = fbench("replay", log, "-p", pipeline, "-o", tmp_path / pipeline.replace("/", "-"))
        assert result.code == 4, result.err
        assert f"lidar {line}; --timeout-ms 399 would wait for all of them" in result.out
        assert "missing: lidar (late) in 6 frames" in result.out
    assert fbench("replay", log, "-p", "radar3d", "-o", tmp_path / "radar").code == 0
    assert fbench("replay", log, "-p", "lidar3d", "-o", tmp_path / "waits", "--timeout-ms", "399").code == 0
    allowed = fbench("replay", log, "-p", "lidar3d", "-o", tmp_path / "ok", "--fault-budget", "FRM001=1")
    assert allowed.code == 0


def test_an_outline_that_is_no_length_is_found_before_anything_is_replayed(fbench, tmp_path, still):
    log = write_log(tmp_path / "wide.mcap", [*messages(), *truths()], metadata={"ego.front_m": "abc"})
    fails(fbench("replay", log, "-p", still(), "-o", tmp_path / "run"), 3, "'ego.front_m' is 'abc'", "in meters")
    assert not (tmp_path / "run").exists()
    (tmp_path / "fbench.toml").write_text("version = 1\n[body]\noutline_m = [3.9, 1.1, 0.95]\n")
    assert fbench("replay", log, "-p", still(), "-o", tmp_path / "run").code == 0
    assert '"ego.front_m": "3.9"' in (tmp_path / "run" / "manifest.json").read_text()
