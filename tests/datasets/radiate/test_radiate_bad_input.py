import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from fbench.datasets.importing.run import import_one
from fbench.datasets.radiate import Radiate
from fbench.datasets.radiate.radar import RadiateParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import FrameRange, ImportRequest
from fbench.replay.logs.open import open_log

SWEEP, POLAR, LEFT = "velo_lidar/000002.csv", "Navtech_Polar/000002.png", "zed_left/000001.png"
TABLE, GPS, CALIB = "velo_lidar.txt", "GPS_IMU_Twist/000001.txt", "default-calib.yaml"
LABELS = "annotations/annotations.json"
TWICE = [{"id": 1, "class_name": name, "bboxes": []} for name in ("car", "van")]
LONG = [{"id": 1, "class_name": "x" * 2000, "bboxes": []}]


def refused(folder: Path, message: str, asked: ImportRequest | None = None) -> None:
    out = folder.parent / "out.mcap"
    with pytest.raises(LogError, match=message) as caught:
        import_one(Radiate(), folder, out, asked)
    assert "\n" not in str(caught.value)
    assert not out.exists()


def test_source_is_not_a_sequence(tmp_path: Path) -> None:
    refused(tmp_path / "none", r"none: no such folder$")
    refused(tmp_path, r"no sequence of RADIATE: no Navtech_Polar/ in it, nor in any folder in it$")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Navtech_Polar", r"fog_1_0: no Navtech_Polar, without polar radar images it can't be imported$"),
        ("Navtech_Polar.txt", r"fog_1_0: no Navtech_Polar.txt, without"),
        ("velo_lidar.txt", r"velo_lidar.txt: no such file, so no file in velo_lidar/ has a time$"),
        ("GPS_IMU_Twist.txt", r"GPS_IMU_Twist.txt: no such file"),
        (CALIB, r"fog_1_0: no default-calib.yaml in it or beside it; .* --set calibration=FILE$"),
    ],
)
def test_files_missing(sequence: Path, name: str, message: str) -> None:
    (sequence / "Navtech_Cartesian").mkdir()
    (sequence / name).rename(sequence.parent / "moved")
    refused(sequence, message)


def test_no_radar_image_has_a_time(sequence: Path) -> None:
    (sequence / "Navtech_Polar.txt").write_text("")
    refused(sequence, r"Navtech_Polar: no image that Navtech_Polar.txt has a time of$")


def test_frames_that_are_not_there(sequence: Path) -> None:
    refused(sequence, r"no radar frame 4:, there are 1 to 3$", ImportRequest(("fog_1_0",), FrameRange(4)))


def test_named_calibration_is_missing(sequence: Path) -> None:
    params = RadiateParams(calibration=sequence / "none.yaml")
    with pytest.raises(ConfigError, match=r"none.yaml: no such file$"):
        import_one(Radiate(params), sequence, sequence.parent / "out.mcap")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (TABLE, "Frame: 2 Time: 12.5\nFrame: x Time: 12.5\n", r"velo_lidar.txt: line 2: 'Frame: x Time: 12.5', exp"),
        (TABLE, "Frame: 2 Time: 12.\n", r"line 1: .*, expected one like 'Frame: 000001 Time"),
        (TABLE, "Frame: 2 Time: 1574859771.7446602720\n", r"line 1: .*, expected one like"),
        (TABLE, "Frame: 2 Time: -1.5\n", r"line 1: .*, expected one like"),
        (TABLE, "Frame: 2 Time: 9999999999.5\n", r"line 1: 9999999999 seconds are no time$"),
        (TABLE, "Frame: 2 Time: 12.5\nFrame: 2 Time: 12.6\n", r"line 2: frame 2 has another time already$"),
        (TABLE, b"Frame: \xff\n", r"velo_lidar.txt: isn't UTF-8 text"),
        (SWEEP, "1,2,3,4,5\n1,2,3,4\n", r"000002.csv: expected rows of x,y,z,intensity,ring \(.*5 columns"),
        (SWEEP, "1,2,3,4,5\n1,two,3,4,5\n", r"000002.csv: expected rows of .*invalid value 'two'"),
        (SWEEP, "x,y,z,intensity,ring\n", r"000002.csv: expected rows of"),
        (SWEEP, "1,2,3,4,5\n1,nan,3,4,5\n", r"000002.csv: line 2: y isn't a finite number$"),
        (SWEEP, "1,2,3,inf,5\n", r"000002.csv: line 1: intensity isn't a finite number$"),
        (SWEEP, "1,2,1e99,4,5\n", r"000002.csv: line 1: z isn't a finite number$"),
        (SWEEP, "1,,3,4,5\n", r"000002.csv: expected rows of"),
        (SWEEP, "1,2,3,4,-5\n", r"000002.csv: expected rows of"),
        (SWEEP, "1,2,3,4,5.5\n", r"000002.csv: expected rows of"),
        (SWEEP, b"1,2,\xff\xfe,4,5\n", r"000002.csv: expected rows of"),
        (SWEEP, b"\x00" * 50, r"000002.csv: expected rows of"),
        (SWEEP, "", r"000002.csv: expected rows of"),
        (POLAR, b"no image", r"000002.png: neither a JPEG nor a PNG"),
        (POLAR, b"", r"000002.png: neither a JPEG nor a PNG"),
        (LEFT, b"no image", r"zed_left/000001.png: neither a JPEG nor a PNG"),
        (LABELS, "{", r"annotations.json: Invalid JSON"),
        (LABELS, "{}", r"annotations.json: Input should be a valid (list|array)"),
        (LABELS, "[[]]", r"annotations.json: 0: "),
        (LABELS, '[{"id": 1}]', r"annotations.json: 0.class_name: Field required"),
        (LABELS, '[{"id": 1, "class_name": "car", "bboxes": {}}]', r"annotations.json: 0.bboxes: Input should be"),
        (LABELS, '[{"id": 1, "class_name": "car", "bboxes": [[], {"rotation": 1}]}]', r"0.bboxes.1.Box.position: "),
        (LABELS, '[{"id": 1, "class_name": "car", "bboxes": [[1]]}]', r"annotations.json: 0.bboxes.0"),
        (LABELS, '[{"id": -1, "class_name": "car", "bboxes": []}]', r"annotations.json: 0.id: Input should be greater"),
        (LABELS, '[{"id": 1e30, "class_name": "car", "bboxes": []}]', r"annotations.json: 0.id: "),
        (LABELS, json.dumps(LONG), r"0.class_name: String should have at most"),
        (LABELS, "[" * 100_000, r"annotations.json: .*(recursion|Invalid JSON)"),
        (LABELS, b"\xff", r"annotations.json: Invalid JSON"),
        (LABELS, json.dumps(TWICE), r"annotations.json: 1: another object has the id 1 already"),
        (GPS, "55.9,-3.3,200\n0,0,0\n", r"GPS_IMU_Twist/000001.txt: 2 lines, expected 18, is it truncated\?$"),
        (CALIB, "lidar_calib: [", r"default-calib.yaml: can't be parsed"),
        (CALIB, "", r"default-calib.yaml: Input should be"),
        (CALIB, "lidar_calib:\n  T: [0, 0, 0]\n", r"default-calib.yaml: lidar_calib.R: Field required"),
        (CALIB, b"\xff", r"default-calib.yaml: isn't UTF-8 text"),
        ("meta.json", "{", r"meta.json: isn't JSON"),
        ("meta.json", "[1]", r"meta.json: expected an object"),
        ("meta.json", "[" * 100_000, r"meta.json: isn't JSON"),
    ],
)  # fmt: skip
def test_broken_files(sequence: Path, name: str, content: str | bytes, message: str) -> None:
    (sequence / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    refused(sequence, message)


@pytest.mark.parametrize("number", ["nan", "1e400", "1e9", "-1", "[1]"])
def test_labels_with_numbers_that_are_none(sequence: Path, number: str) -> None:
    box = f'{{"position": [1, 2, 3, {number}], "rotation": 0}}'
    (sequence / LABELS).write_text(f'[{{"id": 1, "class_name": "car", "bboxes": [{box}]}}]')
    refused(sequence, r"annotations.json: (0.bboxes.0.Box.position.3: |Invalid JSON)")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fx: 10.0", "fx: 0", r"left_cam_calib.fx: Input should be greater than 0"),
        ("fx: 10.0", "fx: nan", r"left_cam_calib.fx: Input should be"),
        ("fx: 10.0", "fx: wide", r"left_cam_calib.fx: Input should be a valid number"),
        ("    fx: 10.0\n", "", r"left_cam_calib.fx: Field required"),
        ("res: [8, 6]", "res: [8]", r"left_cam_calib.res.1: Field required"),
        ("T: [0.6, -0.1, 0.2]", "T: [0.6, -0.1, 1e300]", r"lidar_calib.T.2: Input should be less"),
        ("[0.0, 0.0, 1.0]]", "[0.0, 0.0, -1.0]]", r"stereo_calib.R isn't a rotation"),
        ("[0.0, 0.0, 1.0]]", "[0.0, 1.0, 1.0]]", r"stereo_calib.R isn't a rotation"),
        ("left_cam_calib", "left_camera", r"left_cam_calib: Field required"),
    ],
)
def test_calibration_with_wrong_values(sequence: Path, old: str, new: str, message: str) -> None:
    path = sequence / CALIB
    path.write_text(path.read_text().replace(old, new))
    refused(sequence, rf"default-calib.yaml: {message}")


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        (0, "91,0,0", r"line 1: latitude 91, longitude 0, altitude 0 is no place on Earth$"),
        (0, "55.9,-3.3", r"line 1: expected 3 finite numbers$"),
        (0, "55.9,-3.3,nan", r"line 1: expected 3 finite numbers$"),
        (0, "55.9,-3.3,high", r"line 1: a value is 'high', expected a number$"),
        (4, "0,0,0,0", r"line 5: expected a unit quaternion, got 0,0,0,0$"),
        (16, "1,2", r"line 17: expected 3 finite numbers$"),
    ],
)
def test_fixes_with_wrong_values(sequence: Path, line: int, text: str, message: str) -> None:
    path = sequence / GPS
    lines = path.read_text().splitlines()
    lines[line] = text
    path.write_text("\n".join(lines))
    refused(sequence, rf"000001.txt: {message}")


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def _damage(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[60:-12] = bytes(len(data) - 72)
    path.write_bytes(bytes(data))


def _empty_png(path: Path) -> None:
    """Leave out the pixels; checksums are right."""
    data = path.read_bytes()
    path.write_bytes(data[:33] + data[-12:])


def _write(shape: tuple[int, ...], dtype: type = np.uint8) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(cv2.imencode(".png", np.zeros(shape, dtype))[1].tobytes())


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (POLAR, _cut, r"000002.png: the image has no end, is it truncated\?$"),
        (LEFT, _cut, r"000001.png: the image has no end, is it truncated\?$"),
        (POLAR, _damage, r"000002.png: the image is damaged, a checksum in it is wrong$"),
        (POLAR, _empty_png, r"000002.png: can't be decoded, is it damaged\?$"),
        (POLAR, _write((400, 576)), r"000002.png: 576x400 px, expected a polar image of 400x576$"),
        (POLAR, _write((576, 400, 3)), r"000002.png: expected grey values of 8 bits, got uint8 \(576, 400, 3\)$"),
        (POLAR, _write((576, 400), np.uint16), r"000002.png: expected grey values of 8 bits, got uint16"),
        (LEFT, _write((6, 7, 3)), r"zed_left/000001.png: 7x6 px, expected 8x6 as the calibration says$"),
    ],
)
def test_images_that_are_damaged_or_others(
    sequence: Path, name: str, change: Callable[[Path], object], message: str
) -> None:
    change(sequence / name)
    refused(sequence, message)


@pytest.mark.parametrize(
    "params", [{"radar_height_m": float("nan")}, {"gps_offset_s": float("inf")}, {"min_speed_mps": 0.0}]
)
def test_parameters_are_checked(params: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(params))):
        RadiateParams(**params)  # type: ignore[arg-type]


def test_meta_is_text_that_can_be_stored(sequence: Path) -> None:
    (sequence / "meta.json").write_text('{"name": "half \\ud800 a pair", "type": "a\\nb"}')
    log = import_one(Radiate(), sequence, sequence.parent / "out.mcap")
    metadata = open_log(log.path, FaultLog()).info.metadata
    assert (metadata["sequence"], metadata["weather"]) == ("half   a pair", "a b")
