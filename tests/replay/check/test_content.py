"""Findings about the content of messages, calibration, truth, and the file itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.replay.check.logs import (
    JPEG,
    MS,
    RIG,
    START,
    box,
    changed,
    checked,
    clean,
    found,
    image,
    problems,
    write_moving,
)
from tests.replay.logs.builders import write
from tests.replay.logs.other_forms import NO_SUMMARY, chunks, rewrite

from fbench.replay.check.findings import RULES, require_codes, rule_of
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FAULTS
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import CameraModel, Rig

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.mcap"


def on_third(kind, **values):
    """Change the third message of a type."""

    def change(item):
        return replace(item, **values) if isinstance(item, kind) and item.stamp_ns == START + 200 * MS else item

    return changed(change, clean())


CASES = {
    "empty cloud": (PointCloud, {"xyz": np.zeros((0, 3), np.float32)}, "DAT002"),
    "some points not finite": (RadarScan, {"xyz": np.array([[1, 2, 3], [1, 2, 4], [1, 1, np.nan]], "f4")}, "DAT004"),
    "most points not finite": (PointCloud, {"xyz": np.full((4, 3), np.inf, np.float32)}, "DAT001"),
    "no image": (Image, {"data": b"nothing of use"}, "DEC002"),
    "image cut off": (Image, {"data": JPEG[:-50]}, "DEC002"),
    "image of another size than recorded": (Image, {"size_wh": (40, 30)}, "DEC002"),
    "pose not finite": (Pose, {"translation_m": np.array([0, np.nan, 0])}, "DAT005"),
    "pose without rotation": (Pose, {"rotation_xyzw": np.zeros(4)}, "DAT005"),
    "repeated id": (Truth, {"boxes3d": box(1, center_m=np.ones((2, 3)), size_lwh_m=np.ones((2, 3)),
                                           yaw_rad=np.zeros(2), track_id=np.array([4, 4]))}, "GT003"),
    "box not finite": (Truth, {"boxes3d": box(np.nan)}, "GT004"),
    "box without size": (Truth, {"boxes3d": box(1, size_lwh_m=np.array([[4.0, 0, 1]]))}, "GT004"),
    "box of negative size": (Truth, {"boxes3d": box(1, size_lwh_m=np.array([[4.0, -2, 1]]))}, "GT004"),
    "truth between frames": (Truth, {"stamp_ns": START + 250 * MS}, "GT006"),
}  # fmt: skip


@pytest.mark.parametrize(("kind", "values", "code"), CASES.values(), ids=CASES.keys())
def test_one_bad_message_is_one_finding(path, kind, values, code):
    result = checked(path, on_third(kind, **values))
    assert code in [f.code for f in result.findings if f.severity != "info"]
    assert found(result, code).count == 1
    assert str(START)[:9] in found(result, code).first
    assert found(result, code).advice


def test_raw_images(path):
    def raw(item):
        size = 3 if item.stamp_ns == START + 200 * MS else 80 * 60 * 3
        return replace(item, encoding="rgb8", data=bytes(size)) if isinstance(item, Image) else item

    result = checked(path, changed(raw, clean()), decode_images=True)
    assert [f.code for f in result.findings if f.severity == "error"] == ["DEC002"]
    assert found(result, "DEC002").first.endswith("3 bytes, but 80x60 px need 14400")


def test_images_that_only_decoding_shows_to_be_damaged(path):
    noise = bytearray(JPEG)
    noise[20:200] = bytes(180)  # quantisation tables; header and end are whole
    items = [image(0, m.stamp_ns, bytes(noise)) if isinstance(m, Image) and m.stamp_ns == START else m for m in clean()]
    whole = checked(path, items, decode_images=True)
    assert ("DEC002", "") in problems(whole)


def test_image_size_against_calibration(path):
    rig = Rig(RIG.mounts, {"cam": CameraModel(RIG.cameras["cam"].K, (640, 480))})
    result = checked(path, clean(), rig)
    assert problems(result) == [("FRM001", "cam"), ("LIM003", "")]
    assert found(result, "FRM001").text == "is in 0 of 20 frames: 20 of its messages can't be used"
    assert found(result, "LIM003").count == 20


def test_camera_without_calibration(path):
    result = checked(path, clean(), Rig(RIG.mounts, {}))
    assert problems(result) == [("CAL001", "cam")]
    assert result.frames.num_complete == 20


def test_sensor_without_transform(path):
    mounts = {name: mount for name, mount in RIG.mounts.items() if name != "radar"}
    result = checked(path, clean(), Rig(mounts, RIG.cameras))
    assert problems(result) == [("CAL001", "radar")]
    assert "no transform to the body" in found(result, "CAL001").text


def test_sensor_of_the_rig_without_messages(path):
    result = checked(path, [m for m in clean() if not isinstance(m, RadarScan)])
    assert problems(result) == [("CHK005", "radar")]
    assert result.frames.num_complete == 0


def test_rig_that_changes_is_information(path):
    write_moving(path, 50, clean())
    result = checked(path)
    assert found(result, "CAL002").severity == "info"
    assert result.num_problems == 0
    assert len(result.frames.breaks) == 1


def test_log_without_truth_and_without_sensors(path):
    assert found(checked(path, [m for m in clean() if not isinstance(m, Truth)]), "GT001").severity == "info"
    truths = [m for m in clean() if isinstance(m, Truth)]
    result = checked(path, truths, Rig({}, {}))
    assert problems(result) == []
    assert (result.reference, result.frames.num_frames) == ("boxes", len(truths))
    result = checked(path, [], Rig({}, {}))
    assert problems(result) == [("CHK007", "")]
    assert (result.reference, result.frames) == (None, None)


def test_damaged_chunk(path):
    write(path, clean(), RIG, chunk_size=2000)
    data = bytearray(path.read_bytes())
    at, length = chunks(bytes(data))[5]
    data[at + length // 2] ^= 1
    path.write_bytes(data)
    one = found(checked(path), "LOG004")
    assert (one.severity, one.count) == ("error", 1)
    assert f"byte {at}" in one.first


def test_damaged_chunk_of_an_unused_topic_is_found_too(path, tmp_path):
    from fbench.replay.logs.container import Channel, LogHeader
    from fbench.replay.logs.containers.mcap.write import RawMcapWriter

    writer = RawMcapWriter(path, LogHeader("id"), "none", chunk_size=100)
    for i in range(5):
        writer.add(Channel("/imu", "x"), i, i, 0, bytes(200))
    writer.close()
    data = bytearray(path.read_bytes())
    at, length = chunks(bytes(data))[2]
    data[at + length - 1] ^= 1
    path.write_bytes(data)
    assert found(checked(path), "LOG004").count == 1
    assert found(checked(path), "LOG012").severity == "info"


def test_truncated_log(path):
    write(path, clean(), RIG, chunk_size=2000)
    path.write_bytes(path.read_bytes()[:-3000])
    assert ("LOG002", "") in problems(checked(path))


def test_log_without_checksums_or_index(path, tmp_path):
    write(path, clean(), RIG)
    bare = checked(rewrite(path, tmp_path / "bare.mcap", enable_crcs=False, enable_data_crcs=False, **NO_SUMMARY))
    assert problems(bare) == [("LOG003", ""), ("LOG006", "")]
    ignoring = checked(tmp_path / "bare.mcap", ignored=("LOG006", "LOG003"))
    assert (ignoring.num_problems, found(ignoring, "LOG006").severity) == (0, "info")


def test_what_is_no_log(path):
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(LogError, match=r"log\.mcap"):
        checked(path)


def test_unknown_code_to_ignore():
    with pytest.raises(ConfigError, match=r"LOG06: no such finding; did you mean 'LOG006'"):
        require_codes(["LOG06"])


def test_codes_of_the_docs_are_those_in_the_code():
    rows = [f"| {code} | {rule.severity} | {rule.what} |" for code, rule in RULES.items() if rule.what]
    assert "\n".join(rows) in (ROOT / "docs" / "logs.md").read_text()


def test_every_code_has_a_rule_with_advice():
    for code in [*RULES, *FAULTS]:
        assert rule_of(code).severity in ("error", "warning", "info")
        assert rule_of(code).advice
        assert code in FAULTS or rule_of(code).what
    assert not [code for code in FAULTS if code.startswith("CHK")]
