"""A camera recorded as video, from the command line: every way to read a log shows the same pictures."""

import builtins
import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from tests.cli.conftest import fbench
from tests.replay.logs import builders as b
from tests.replay.logs.codecs.video import builders as v

from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image

__all__ = ["fbench"]

PACKETS = v.encode(num=24, key_every=8)
PIPELINE = """
import hashlib
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Fault, Output
from fbench.replay.data.images import decode

class Mine:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame):
        image = frame.messages.get("cam")
        pixels = None if image is None or SKIP else decode(image)
        if pixels is None:
            faults = () if image is None or SKIP else (Fault("DEC002", f"cam at {image.stamp_ns}"),)
            return Output(Boxes3D.empty(), Boxes3D.empty(), {}, faults=faults)
        number = int.from_bytes(hashlib.sha256(pixels.tobytes()).digest()[:4], "big") / 1e6
        found = Boxes3D(np.array([[number, 0, 0]]), np.ones((1, 3)), np.zeros(1), score=np.ones(1))
        return Output(found, found, {})
"""
"""Detections tell pictures apart: their digest stands for x."""


@pytest.fixture
def here(fbench, tmp_path):
    (tmp_path / "mine.py").write_text(PIPELINE.replace("SKIP", "False"))
    (tmp_path / "blind.py").write_text(PIPELINE.replace("SKIP", "True"))
    v.write_log(tmp_path / "log.mcap", PACKETS)
    return fbench


def replay(fbench, log, *more, out, pipeline="mine.py:Mine", code=0):
    result = fbench("replay", log, "-p", pipeline, "-o", out, "--json", *more)
    assert result.code == code, result.err + result.out
    return result


def table(path):
    return pd.read_parquet(path)


def detections(folder):
    """What stands for the picture, by frame."""
    found = table(f"{folder}/detections.parquet")
    return dict(zip(found["frame"].tolist(), (center[0] for center in found["center_m"]), strict=True))


def count_faults(folder):
    rows = json.loads(Path(folder, "faults.json").read_text())["rows"]
    return {row["code"]: row["count"] for row in rows if row["count"]}


def digests(folder):
    return table(f"{folder}/frames.parquet")["digest"].tolist()


def test_rates_reading_ahead_containers_and_excerpts_change_nothing(here, tmp_path):
    replay(here, "log.mcap", out="base")
    base = detections("base")
    assert sorted(base) == list(range(24))
    assert len(set(base.values())) == 24
    assert here("log", "convert", "log.mcap", "-o", "log.parquet").code == 0
    assert here("log", "convert", "log.mcap", "-o", "own.mcap", "--decode").code == 0
    assert here("log", "convert", "own.mcap", "-o", "own.parquet").code == 0
    variants = [
        ("log.mcap", "--read-ahead", "0"), ("log.mcap", "--read-ahead", "all"), ("log.mcap", "--rate", "50"),
        ("log.parquet",), ("own.mcap",), ("own.parquet",),
    ]  # fmt: skip
    for i, (log, *more) in enumerate(variants):
        replay(here, log, *more, out=f"run{i}")
        assert digests(f"run{i}") == digests("base"), (log, *more)
    for i, (option, frames) in enumerate([("--from=1.1", range(11, 24)), ("--frames=5:7", range(5, 7))]):
        replay(here, "log.mcap", option, out=f"part{i}")
        assert detections(f"part{i}") == {k: base[k] for k in frames}


def test_pictures_that_are_in_no_frame_are_decoded_all_the_same(here, tmp_path):
    """The LiDAR measures a third as often as the camera, and frames get its instants."""
    replay(here, "log.mcap", out="base")
    v.write_log(tmp_path / "slow.mcap", PACKETS, points_every=3)
    replay(here, "slow.mcap", out="slow")
    assert list(detections("slow").values()) == list(detections("base").values())[::3]


def test_lost_messages_are_faults_and_no_picture_is_wrong(here, tmp_path):
    replay(here, "log.mcap", out="base")
    base = detections("base")
    v.write_log(tmp_path / "lossy.mcap", PACKETS, left_out=[11])
    replay(here, "lossy.mcap", out="lossy", code=4)
    assert detections("lossy") == {k: x for k, x in base.items() if not 11 <= k < 16}
    missing = [json.loads(text) for text in table("lossy/frames.parquet")["missing"]]
    assert missing[12]["cam"] == "skipped: video a message before it is missing: picture 4 comes after 2"
    assert count_faults("lossy") == {"DEC004": 4}
    found = here("log", "check", "lossy.mcap", "--json")
    assert found.code == 1
    (lost,) = [row for row in found.json()["findings"] if row["code"] == "DEC004"]
    assert lost["count"] == 4


def test_a_recording_that_begins_between_keyframes_is_complete(here, tmp_path):
    v.write_log(tmp_path / "late.mcap", PACKETS[5:])
    replay(here, "late.mcap", out="late")
    assert sorted(detections("late")) == list(range(3, 19))
    assert count_faults("late") == {"DEC005": 3}
    check = here("log", "check", "late.mcap", "--json").json()["findings"]
    assert [row["severity"] for row in check if row["code"] == "DEC005"] == ["info"]


def test_a_cut_begins_with_a_keyframe(here, tmp_path):
    replay(here, "log.mcap", out="base")
    base = detections("base")
    for name, more in (("cut.mcap", ()), ("cut.parquet", ()), ("own.mcap", ("--decode",))):
        assert here("log", "convert", "log.mcap", "-o", name, "--from", "1.15", "--to", "1.85", *more).code == 0
        images = b.numbers(list(b.read(tmp_path / name)[0].messages()), Image)
        assert [image.data for image in images] == PACKETS[8:19]
        assert [(image.log_ns - v.START) // v.MS for image in images] == [100 * i + 1 for i in range(8, 19)]
        replay(here, name, out=f"run-{name}")
        assert list(detections(f"run-{name}").values()) == [base[i] for i in range(12, 19)]
    assert here("log", "convert", "log.mcap", "-o", "key.mcap", "--from", f"{v.START + 801 * v.MS}ns").code == 0
    images = b.numbers(list(b.read(tmp_path / "key.mcap")[0].messages()), Image)
    assert [image.data for image in images] == PACKETS[8:]


def test_conversion_keeps_every_byte(here, tmp_path):
    assert here("log", "convert", "log.mcap", "-o", "log.parquet").code == 0
    assert here("log", "convert", "log.parquet", "-o", "again.mcap").code == 0
    found = []
    for name in ("log.mcap", "again.mcap"):
        with (tmp_path / name).open("rb") as file:
            found.append([(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()])
    assert sorted(found[0]) == sorted(found[1])


def test_info_init_check_and_preview(here, tmp_path):
    info = here("log", "info", "log.mcap", "--json")
    assert info.code == 0
    (camera,) = [row for row in info.json()["streams"] if row["sensor"] == "cam"]
    assert camera["num_messages"] == 24
    assert here("log", "check", "log.mcap", "--images", "--ignore", "GT001").code == 0
    assert here("init", "log.mcap").code == 0
    text = (tmp_path / "fbench.toml").read_text()
    assert 'topic = "/cam/video"' in text
    assert "but it is for" not in text
    assert here("log", "preview", "log.mcap", "--num", "2").code == 0
    assert list((tmp_path / "log-preview").glob("*cam*.png"))


def test_init_keeps_a_camera_of_which_its_windows_hold_no_keyframe(here, tmp_path):
    """Keyframes at 0, 20 and 40 s, of which the first is lost; init reads 6 s from the beginning and the middle."""
    log = v.write_log(tmp_path / "rare.mcap", v.encode(num=420, key_every=200), left_out=range(3))
    assert here("init", log.name).code == 0
    assert tomllib.loads((tmp_path / "fbench.toml").read_text())["sensors"].keys() == {"cam_video", "lidar"}


def test_checking_images_finds_what_headers_dont_tell(here, tmp_path):
    packets = v.encode("h265", num=16, key_every=8)
    v.write_log(tmp_path / "hevc.mcap", packets, "h265", left_out=[3])
    assert "DEC002" not in here("log", "check", "hevc.mcap").out
    found = here("log", "check", "hevc.mcap", "--images", "--json").json()["findings"]
    (row,) = [row for row in found if row["code"] == "DEC002"]
    assert row["count"] == 4


def test_programs_get_decoded_images(tmp_path):
    from fbench.pipelines.external.messages import decode_videos
    from fbench.replay.data.boxes import Boxes3D
    from fbench.replay.data.frames import Frame, Output

    reader, _ = b.read(v.write_log(tmp_path / "hevc.mcap", v.encode("h265", num=6), "h265", left_out=[2]))
    images = b.numbers(list(reader.messages()), Image)
    empty = Output(Boxes3D.empty(), Boxes3D.empty(), {"detect": 5})
    shown = decode_videos(Frame(0, 5, 0, {"cam": images[1]}))
    sent = shown.frame.messages["cam"]
    assert (sent.encoding, sent.video) == ("bgr8", None)
    np.testing.assert_array_equal(decode(sent), decode(images[1]))
    assert list(shown.complete(empty).stage_ns) == ["decode", "detect"]
    damaged = decode_videos(Frame(1, 5, 0, {"cam": images[2]}))
    assert (dict(damaged.frame.messages), damaged.frame.missing) == ({}, {"cam": "video can't be decoded"})
    output = damaged.complete(empty)
    assert ([fault.code for fault in output.faults], output.missing) == (["DEC002"], {"cam": "video can't be decoded"})


def test_without_pyav_only_what_decodes_says_so(here, monkeypatch, tmp_path):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "av" or name.startswith("av."):
            raise ImportError("No module named 'av'")
        return real(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "av", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)
    assert here("log", "info", "log.mcap").code == 0
    assert here("log", "check", "log.mcap", "--ignore", "GT001").code == 0
    assert here("log", "convert", "log.mcap", "-o", "cut.mcap", "--from", "1").code == 0
    assert here("init", "log.mcap").code == 0
    (tmp_path / "fbench.toml").unlink()  # it names sensors its own way
    replay(here, "log.mcap", pipeline="blind.py:Mine", out="blind")
    result = here("replay", "log.mcap", "-p", "mine.py:Mine", "-o", "run")
    assert result.code == 2
    line = "a log has video, which needs PyAV (No module named 'av'): pip install 'fbench[video]'"
    assert result.err.strip().splitlines()[-1].endswith(line)
    assert not (tmp_path / "run").exists()
    assert line in here("log", "check", "log.mcap", "--images").err
