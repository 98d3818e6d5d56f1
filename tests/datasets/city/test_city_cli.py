"""`fbench log simulate`, as a user calls it, and misuses it."""

import json
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.datasets.city.city_logs import read
from tests.program import fbench as run

FBENCH = [sys.executable, "-c", "from fbench.cli import main; main()"]
SHORT = ("--sensors", "radar", "--set", "radar.points_per_s=2000", "--seconds", "0.1")
# Seeds are 0 and 1 throughout, as each other city takes seconds to build.


@pytest.fixture
def fbench(monkeypatch, capsys, tmp_path):
    """Call `fbench log simulate ARGS` in an empty folder; returns code, output, errors."""
    monkeypatch.chdir(tmp_path)

    def call(*args):
        code = run("log", "simulate", *args)
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return code, captured.out, captured.err

    return call


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["rural", "-o", "a.mcap"], "did you mean 'urban'?"),
        (["urban"], "Missing option '--out'"),
        (["urban", "-o", "a"], "which form?"),
        (["urban", "-o", "a.txt"], "which form?"),
        (["urban", "-o", ""], "which form?"),
        (["urban", "-o", "/dev/null/a.mcap"], "can't be written (Not a directory"),
        (["urban", "-o", "/proc/a.mcap"], "can't be written"),
        (["urban", "-o", "a.mcap", "--condition", "foog"], "did you mean 'fog'?"),
        (["urban", "-o", "a.mcap", "--condition", ""], "there are: clear"),
        (["urban", "-o", "a.mcap", "--condition", "fog+fog"], "comes twice"),
        (["urban", "-o", "a.mcap", "--seconds", "nan"], "expected 0.1 to 86400"),
        (["urban", "-o", "a.mcap", "--seconds", "-1"], "expected 0.1 to 86400"),
        (["urban", "-o", "a.mcap", "--seconds", "inf"], "expected 0.1 to 86400"),
        (["urban", "-o", "a.mcap", "--seed", "-1"], "expected 0 to 2^63 - 1"),
        (["urban", "-o", "a.mcap", "--seed", str(10**30)], "expected 0 to 2^63 - 1"),
        (["urban", "-o", "a.mcap", "--seed", "x"], "valid integer"),
        (["urban", "-o", "a.mcap", "--threads", "0"], "--threads"),
        (["urban", "-o", "a.mcap", "--sensors", "sonar"], "fits no sensor"),
        (["urban", "-o", "a.mcap", "--set", "lidar.rate_hz=1e-300"], "lidars.lidar.rate_hz"),
        (["urban", "-o", "a.mcap", "--set", "lidar.range_m=1e300"], "lidars.lidar.range_m"),
        (
            ["urban", "-o", "a.mcap", "--set", "lidar.lower_deg=31"],
            "lidars.lidar: lower_deg must not be above upper_deg",
        ),
        (["urban", "-o", "a.mcap", "--set", "lidar.motion=1"], "boolean"),
        (["urban", "-o", "a.mcap", "--set", "radar.clutter=1e300"], "radars.radar.clutter"),
        (["urban", "-o", "a.mcap", "--set", "radar.latency_ms=1e300"], "radars.radar.latency_ms"),
        (["urban", "-o", "a.mcap", "--set", "radar.translation_m=[1e300, 0, 0]"], "radars.radar.translation_m"),
        (["urban", "-o", "a.mcap", "--set", "camera.size_wh=[8192, 8192]"], "cameras.camera: size_wh must be at most"),
        (["urban", "-o", "a.mcap", "--set", "camera.fov_deg=nan"], "cameras.camera.fov_deg"),
        (["urban", "-o", "a.mcap", "--set", "weather.lux=nan"], "Weather.lux"),
        (["urban", "-o", "a.mcap", "--form", "parquet"], "--form is only for a suite"),
        (["urban", "-o", "a.mcap", "--split", "test"], "--split is only for a suite"),
        (["suite", "-o", "s", "--seed", "3"], "not for the suite, which has its own"),
        (["suite", "-o", "s", "--condition", "fog"], "not for the suite, which has its own"),
        (["suite", "-o", "s", "--set", "weather.lux=1e9"], "Weather.lux"),
        (["suite", "-o", "/proc/s"], "can't be written"),
        (["training", "-o", "s", "--seconds", "5"], "training: these logs are fixed"),
        (["training", "-o", "s", "--split", "dev"], "training: these logs are fixed"),
        (["training", "-o", "/proc/s"], "can't be written"),
        (["urban", "-o", "a.mcap", "--rig", "absent.toml"], "no such file"),
    ],
)
def test_what_cannot_be_is_one_line(fbench, tmp_path, args, says):
    code, out, err = fbench(*args)
    assert (code, out) == (2, "")
    assert says in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00\xff\xfe",
        b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
        b"#" * 3_000_000,
        b"a = " + b"[" * 100_000,
        b"[lidars.a]\ntranslation_m = " + b"[" * 500 + b"]" * 500,
        b"[lidars.a]\ntranslation_m = [nan, 0, 0]",
        b"[lidars.a]\ntranslation_m = [0, 0, 2]\nlatency_ms = inf",
        b"[lidars.a]\ntranslation_m = [0, 0, 2]\nchannels = 1e3",
        b"[lidars.a]\ntranslation_m = [0, 0, 2]\npoints_per_s = 20000000\nrate_hz = 0.5",
        b"[lidars.a]\ntranslation_m = [0, 0, 2]\nrate_hz = 99999999999999999999999999",
        b"[lidars]\na = 1979-05-27",
        b"[lidars.'../../a']\ntranslation_m = [0, 0, 2]",
        b"[cameras.a]\ntranslation_m = [0, 0, 2]\nsize_wh = [64, 48.5]",
        b"[cameras.a.b.c.d]\ntranslation_m = [0, 0, 2]",
        b"pose_rate_hz = 0",
        b"[lidars.a]\ntranslation_m = [0, 0, 2]\n[lidars.a]\ntranslation_m = [0, 0, 2]",
    ],
    ids=lambda content: repr(content[:40]),
)
def test_damaged_rigs_are_one_line(fbench, tmp_path, content):
    (tmp_path / "rig.toml").write_bytes(content)
    code, out, err = fbench("urban", "-o", "a.mcap", "--rig", "rig.toml")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("fbench: rig.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


@pytest.mark.slow
def test_json_says_what_was_made(fbench, tmp_path):
    code, out, _ = fbench("urban", *SHORT, "--seed", "1", "-o", "a.mcap", "--json")
    (log,) = json.loads(out)["logs"]
    assert code == 0
    assert list(log) == [
        "path", "state", "log_id", "world", "condition", "seed", "seconds", "bytes", "messages", "summary",
    ]  # fmt: skip
    assert (log["path"], log["state"], log["seed"], log["seconds"]) == ("a.mcap", "written", 1, 0.1)
    assert log["messages"] == {"/pose": 10, "/radar/points": 2, "/truth/boxes": 2}
    made = read(tmp_path / "a.mcap")
    assert made.info.log_id == log["log_id"]
    assert len(made.scans()) == len(made.truths) == 2


@pytest.mark.slow
def test_a_log_that_is_there_stays_unless_told_otherwise(fbench, tmp_path):
    args = ("urban", *SHORT, "-o", "a.mcap")
    assert fbench(*args)[0] == 0
    first = (tmp_path / "a.mcap").read_bytes()
    written = (tmp_path / "a.mcap").stat().st_mtime_ns
    code, out, _ = fbench(*args)
    assert (code, "is there already" in out) == (0, True)
    assert (tmp_path / "a.mcap").stat().st_mtime_ns == written
    code, _, err = fbench(*args, "--seed", "1")
    assert (code, "is another log" in err) == (2, True)
    assert (tmp_path / "a.mcap").read_bytes() == first
    assert fbench(*args, "--seed", "1", "--overwrite")[0] == 0
    assert (tmp_path / "a.mcap").read_bytes() != first
    (tmp_path / "b.mcap").write_bytes(b"something else")
    code, _, err = fbench("urban", *SHORT, "-o", "b.mcap")
    assert (code, "exists already" in err) == (2, True)
    assert (tmp_path / "b.mcap").read_bytes() == b"something else"


def test_settings_of_sensors_that_are_left_out_are_told(fbench):
    settings = ("--set", "weather.lux=10", "--set", "camera.rate_hz=3.0")
    code, _, err = fbench("urban", *SHORT, *settings, "-o", "a.mcap")
    assert (code, err) == (0, "note: --set camera.rate_hz=3.0 changes nothing: --sensors leaves 'camera' out\n")


@pytest.mark.slow
def test_logs_say_which_show_one_scene(fbench, tmp_path):
    def scene(*args):
        assert fbench("highway", *SHORT, *args, "-o", "a.mcap", "--overwrite")[0] == 0
        return read(tmp_path / "a.mcap").info.metadata["scene_id"]

    here = scene("--seed", "0")
    others = (["--condition", "fog+night"], ["--set", "radar.rate_hz=10.0"], ["--set", "weather.lux=7"])
    assert {scene("--seed", "0", *args) for args in others} == {here}
    apart = (["--seed", "1"], ["--condition", "traffic"], ["--seconds", "0.2"])
    assert here not in {scene(*args) for args in apart}


def test_sensors_in_another_order_are_the_same_log(fbench, tmp_path):
    parts = ["[radars.a]\ntranslation_m = [2, 0, 1]\npoints_per_s = 2000\n", "[radars.b]\ntranslation_m = [2, 0, 1]\n"]
    ids = []
    for order in (parts, parts[::-1]):
        (tmp_path / "rig.toml").write_text("".join(order))
        ids.append(fbench("urban", "--seconds", "0.1", "--rig", "rig.toml", "-o", "a.mcap", "--json")[1])
    assert [json.loads(text)["logs"][0]["state"] for text in ids] == ["written", "there"]


EXTREME = {
    "one channel": ("lidar", ["lidar.channels=1"]),
    "one point": ("lidar", ["lidar.points_per_s=1"]),
    "no point": ("lidar", ["lidar.dropout=1"]),
    "no message": ("lidar", ["lidar.loss=1"]),
    "up and down": ("lidar", ["lidar.upper_deg=90", "lidar.lower_deg=-90", "lidar.points_per_s=100000"]),
    "1000 Hz": ("lidar", ["lidar.rate_hz=1000", "lidar.points_per_s=20000"]),
    "underground": ("lidar", ["lidar.translation_m=[0, 0, -5]", "lidar.points_per_s=100000"]),
    "sky": ("camera", ["camera.size_wh=[16, 16]", "camera.yaw_pitch_roll_deg=[0, -90, 0]", "camera.fov_deg=1.1"]),
    "inside": ("camera", ["camera.size_wh=[64, 48]", "camera.translation_m=[0, 0, 0.5]", "camera.fov_deg=169"]),
    "cellar": ("camera", ["camera.size_wh=[64, 48]", "camera.translation_m=[0, 0, -3]"]),
    "all round": ("radar", ["radar.horizontal_fov_deg=180", "radar.vertical_fov_deg=120", "radar.multipath=1"]),
    "near": ("radar", ["radar.range_m=0.05", "radar.clutter=3"]),
    "one ray": ("radar", ["radar.points_per_s=1"]),
    "late": ("radar", ["radar.latency_ms=60000"]),
    "worst": ("*", ["weather.visibility_m=10", "weather.rain_mm_h=300", "weather.lux=0"]),
    "zenith": ("camera", ["weather.sun_elevation_deg=90", "camera.size_wh=[64, 48]"]),
    "nadir": ("camera", ["weather.sun_elevation_deg=-90", "weather.lux=150000", "camera.size_wh=[64, 48]"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXTREME)
def test_extreme_rigs_and_weathers_give_logs(fbench, tmp_path, name):
    sensors, settings = EXTREME[name]
    args = [part for setting in settings for part in ("--set", setting)]
    small = [f"{camera}.size_wh=[64, 48]" for camera in ("camera", "stereo_left", "stereo_right")]
    args = [*(part for setting in small for part in ("--set", setting)), *args]
    code, _, err = fbench("urban", "--sensors", sensors, "--seconds", "0.13", *args, "-o", "a.mcap")
    assert code == 0
    assert all(line.startswith("note: --set ") for line in err.splitlines())
    log = read(tmp_path / "a.mcap")
    assert log.truths
    assert len(log.messages) >= 13


@pytest.mark.slow
def test_two_sensors_at_one_place_measure_with_their_own_noise(fbench, tmp_path):
    top = "translation_m = [0, 0, 2]\npoints_per_s = 50000\n"
    (tmp_path / "rig.toml").write_text(f"[lidars.a]\n{top}[lidars.b]\n{top}")
    assert fbench("highway", "--seconds", "0.1", "--rig", "rig.toml", "-o", "a.mcap")[0] == 0
    log = read(tmp_path / "a.mcap")
    a, b = log.clouds("a"), log.clouds("b")
    first = min(a)
    assert len(a[first].xyz) == len(b[first].xyz)
    assert a[first].xyz.tobytes() != b[first].xyz.tobytes()
    truth = log.truths[first].boxes3d
    assert truth.num_lidar_pts.sum() % 2 == 0  # both count


@pytest.mark.slow
def test_parquet_and_other_views_of_a_log(fbench, tmp_path, capsys):
    assert fbench("urban", *SHORT, "-o", "a.parquet")[0] == 0
    assert fbench("urban", *SHORT, "-o", "a.mcap")[0] == 0
    a, b = read(tmp_path / "a.parquet"), read(tmp_path / "a.mcap")
    assert a.info.log_id == b.info.log_id
    assert [m.stamp_ns for m in a.messages] == [m.stamp_ns for m in b.messages]
    assert run("log", "info", "a.mcap") == 0
    assert "of kind road" in capsys.readouterr().out
    assert run("log", "preview", "a.mcap", "-o", "preview") == 0
    assert (tmp_path / "preview" / "index.html").is_file()


def _rest(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name not in ("out", "numba"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_who_is_stopped_leaves_no_log(tmp_path, kind):
    args = ["log", "simulate", "highway", "--sensors", "lidar", "--seconds", "600", "-o", "a.mcap"]
    with (tmp_path / "out").open("w") as out:
        process = subprocess.Popen([*FBENCH, *args], cwd=tmp_path, stdout=out, stderr=out)
        end = time.monotonic() + 600
        while time.monotonic() < end and not any(path.stat().st_size > 1e5 for path in tmp_path.iterdir()):
            time.sleep(0.1)
        process.send_signal(kind)
        assert process.wait(300) != 0
    said = (tmp_path / "out").read_text()
    assert "Traceback" not in said
    assert not (tmp_path / "a.mcap").exists()
    if kind == signal.SIGINT:
        assert (process.returncode, said) == (130, "fbench: interrupted; nothing written\n")
        assert _rest(tmp_path) == []


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_leaves_no_log(fbench, tmp_path):
    most, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, hard))
    try:
        code, _, err = fbench("highway", "--sensors", "lidar", "--seconds", "1", "-o", "a.mcap")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))
    assert (code, err.count("\n")) == (3, 1)
    assert "a.mcap: can't be written" in err
    assert _rest(tmp_path) == []
