"""Folders of the tracking and object benchmarks that can't be used as they are."""

import os
import struct
from collections.abc import Callable
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from fbench.datasets.importing.run import ImportedLog, import_recordings
from fbench.datasets.kitti import Kitti
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest
from fbench.replay.data.images import encode_jpeg
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.open import open_log

CAR = "Car 0 1 -1.79 10.5 5 60 30.25 1.5 2.0 4.0 3 1.6 20 0.5"
LABELS, CALIB = "label_02/0000.txt", "calib/0000.txt"


def run(source: Path, bad: BadInput, frames: FrameRange | None = None) -> ImportedLog:
    """Import the first sequence beside the folder."""
    name, out = Kitti().names(source)[0], source.parent / "out.mcap"
    asked = ImportRequest((name,), frames or FrameRange(), bad)
    return next(import_recordings(Kitti(), source, asked, {name: Target(out, overwrite=True)}))


def refused(source: Path, message: str) -> None:
    with pytest.raises(LogError, match=message) as caught:
        run(source, BadInput())
    assert "\n" not in str(caught.value)
    assert not (source.parent / "out.mcap").exists()


def skipped(source: Path, num: int) -> ImportedLog:
    bad = BadInput(skip=True)
    log = run(source, bad)
    assert bad.num == num, bad.texts
    return log


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, r"odd: no such folder$"),
        (lambda path: path.touch(), r"odd: not a folder$"),
        (lambda path: path.mkdir(), r"odd: no KITTI data; expected raw drives .* the tracking benchmark .* the object"),
        (lambda path: (path / "calib").mkdir(parents=True), r"odd: no KITTI data"),
        (lambda path: (path / "label_02").mkdir(parents=True), r"odd: no KITTI data"),
        (lambda path: (path / "training/label_2").mkdir(parents=True), r"odd: no KITTI data"),
    ],
)
def test_wrong_folders(tmp_path: Path, make: Callable[[Path], None], message: str) -> None:
    make(tmp_path / "odd")
    with pytest.raises(LogError, match=message):
        Kitti().names(tmp_path / "odd")


def test_a_sequence_without_frames(tracking_folder: Path) -> None:
    for path in (*tracking_folder.glob("image_02/0000/*"), *tracking_folder.glob("velodyne/0000/*")):
        path.unlink()
    (tracking_folder / LABELS).unlink()
    (tracking_folder / "evaluate_tracking.seqmap.training").unlink()
    refused(tracking_folder, r"sequence 0000 has no frame$")


def test_frames_outside_of_the_sequence(tracking_folder: Path) -> None:
    with pytest.raises(LogError, match="nothing in it to import"):
        run(tracking_folder, BadInput(), FrameRange(40))


def test_no_calibration(tracking_folder: Path) -> None:
    (tracking_folder / CALIB).unlink()
    refused(tracking_folder, r"calib/0000.txt: can't be read \(No such file")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("P2:", "Q2:", r"calib/0000.txt: no P2$"),
        ("R_rect", "R", r"calib/0000.txt: no R0_rect$"),
        ("Tr_velo_cam", "Tr", r"calib/0000.txt: no Tr_velo_to_cam$"),
        ("P2: 700", "P2:", r"calib/0000.txt line 3: P2 has 11 numbers, expected 12$"),
        ("P2: 700", "P2: nan", r"line 3: P2 has a number that isn't finite"),
        ("P2: 700", "P2: 1e30", r"line 3: P2 has a number that isn't finite, or is beyond all reason"),
        ("P2: 700", "P2: x", r"line 3: P2 is 'x', expected a number"),
        ("P2: 700", "P2: 0", r"line 3: P2 isn't a camera's projection"),
        ("R_rect 1", "R_rect 2", r"line 5: R_rect isn't a rotation"),
        ("R_rect 1 0 0 0 1 0 0 0 1", "R_rect 1 0 0 0 1 0 0 0 -1", r"line 5: R_rect isn't a rotation"),
        ("P3:", "P2:", r"line 4: P2 a second time$"),
        ("P2: 700", "P2: \xff", r"line 3: P2 is"),
    ],
)
def test_broken_calibration(tracking_folder: Path, old: str, new: str, message: str) -> None:
    path = tracking_folder / CALIB
    path.write_text(path.read_text().replace(old, new))
    refused(tracking_folder, message)


def test_calibration_that_is_no_text(tracking_folder: Path) -> None:
    (tracking_folder / CALIB).write_bytes(b"P2: \xff\xfe\n")
    refused(tracking_folder, r"calib/0000.txt: isn't UTF-8 text")


def test_a_missing_imu_leaves_poses_out(tracking_folder: Path) -> None:
    path = tracking_folder / CALIB
    path.write_text(path.read_text().replace("Tr_imu_velo", "Tr"))
    log = run(tracking_folder, BadInput())
    assert "poses: left out, as the calibration doesn't tell where the IMU is" in log.lines


ROWS = [
    (f"0 1 {CAR[:-4]}", r"label_02/0000.txt line 2: 16 columns, expected 17"),
    ("0", r"0000.txt line 2: 1 columns, expected 17"),
    (f"0 1 {CAR} 1 2 3 4", None),
    (f"0 1 {CAR.replace('20', 'far')}", r"line 2: z is 'far', expected a number"),
    (f"0 1 {CAR.replace('20', 'nan')}", r"line 2: a number isn't finite, or is beyond all reason$"),
    (f"0 1 {CAR.replace('20', '1e300')}", r"line 2: a number isn't finite, or is beyond all reason$"),
    (f"x 1 {CAR}", r"line 2: frame is 'x', expected a whole number"),
    (f"7777777 1 {CAR}", r"line 2: frame is 7777777, expected less than 200000"),
    (f"0 1.5 {CAR}", r"line 2: track id is '1.5', expected a whole number"),
    (f"0 7 {CAR}", r"line 2: id 7 twice in frame 0"),
]


@pytest.mark.parametrize(("row", "message"), ROWS)
def test_broken_labels(tracking_folder: Path, row: str, message: str | None) -> None:
    (tracking_folder / LABELS).write_text(f"0 7 {CAR}\n{row}\n1 7 {CAR}\n")
    if message is None:
        run(tracking_folder, BadInput())
        return
    refused(tracking_folder, message)
    skipped(tracking_folder, 1)
    truths = list(open_log(tracking_folder.parent / "out.mcap", FaultLog()).truths())
    assert [len(t.boxes3d) for t in truths] == [1, 1, 0, 0]


def test_labels_that_are_no_text(tracking_folder: Path) -> None:
    (tracking_folder / LABELS).write_bytes(f"0 7 {CAR}\n".encode() + b"\xff\n")
    refused(tracking_folder, r"label_02/0000.txt: isn't UTF-8 text")
    assert skipped(tracking_folder, 1).state == "failed"


def test_a_class_that_the_benchmark_lacks(tracking_folder: Path) -> None:
    (tracking_folder / LABELS).write_text(f"0 7 {CAR.replace('Car', 'Spaceship')}\n0 8 {CAR.replace('Car', 'bus')}\n")
    log = run(tracking_folder, BadInput())
    assert "classes that the benchmark lacks, taken by their names: Spaceship, bus" in log.lines
    truth = next(iter(open_log(log.path, FaultLog()).truths()))
    assert truth.boxes3d.label.tolist() == ["other", "bus"]
    assert truth.boxes3d.source_label.tolist() == ["Spaceship", "bus"]


def test_labels_behind_the_last_file(tracking_folder: Path) -> None:
    with (tracking_folder / LABELS).open("a") as file:
        file.write(f"6 7 {CAR}\n")
    log = run(tracking_folder, BadInput())
    assert "labels go on behind the last file: frames 4 to 6" in log.lines
    assert [t.frame_number for t in open_log(log.path, FaultLog()).truths()] == list(range(7))


def test_images_of_another_size(tracking_folder: Path) -> None:
    path = tracking_folder / "image_02/0000/000002.png"
    path.write_bytes(encode_jpeg(np.zeros((30, 100, 3), np.uint8)))
    refused(tracking_folder, r"image_02/0000/000002.png: 100x30 px, expected 100x40")
    skipped(tracking_folder, 1)
    reader = open_log(tracking_folder.parent / "out.mcap", FaultLog())
    assert [m.frame_number for m in reader.messages() if m.sensor == "image_02"] == [0, 1, 3]


@pytest.mark.parametrize("keep", [0, 20, -4])
def test_a_truncated_image(tracking_folder: Path, keep: int) -> None:
    path = tracking_folder / "image_02/0000/000000.png"
    path.write_bytes(path.read_bytes()[: keep or 0] if keep >= 0 else path.read_bytes()[:keep])
    refused(tracking_folder, r"image_02/0000/000000.png: ")
    skipped(tracking_folder, 1)
    assert open_log(tracking_folder.parent / "out.mcap", FaultLog()).rig.cameras["image_02"].size_wh == (100, 40)


def test_truncated_points(tracking_folder: Path) -> None:
    path = tracking_folder / "velodyne/0000/000002.bin"
    path.write_bytes(path.read_bytes()[:-3])
    refused(tracking_folder, r"velodyne/0000/000002.bin: 29 bytes aren't whole rows of 4 float32, is it truncated\?")
    skipped(tracking_folder, 1)


def test_points_of_no_return(tracking_folder: Path) -> None:
    """An interrupted download leaves such files; no sweep of a road is without any return."""
    (tracking_folder / "velodyne/0000/000002.bin").write_bytes(b"")
    refused(tracking_folder, r"000002.bin: is empty, is it truncated\?$")
    skipped(tracking_folder, 1)


def test_other_files_are_left_alone(tracking_folder: Path) -> None:
    for name in ("velodyne/0000/notes.txt", "velodyne/0000/12.bin", "image_02/0000/Thumbs.db", "label_02/README.txt"):
        (tracking_folder / name).write_text("x")
    (tracking_folder / "label_02/0009.txt").mkdir()
    assert run(tracking_folder, BadInput()).lines[1] == "files: image_02 4, velodyne 3"


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1 2 3", r"oxts/0000.txt line 3: 3 values, expected 30"),
        (" ".join(["nan"] * 30), r"oxts/0000.txt line 3: latitude is 'nan'"),
        (" ".join(["91"] * 30), r"oxts/0000.txt line 3: .* is no place on Earth"),
    ],
)
def test_broken_poses(tracking_folder: Path, row: str, message: str) -> None:
    path = tracking_folder / "oxts/0000.txt"
    rows = path.read_text().splitlines()
    path.write_text("\n".join([*rows[:2], row, *rows[3:]]))
    refused(tracking_folder, message)
    skipped(tracking_folder, 1)
    reader = open_log(tracking_folder.parent / "out.mcap", FaultLog())
    assert [m.frame_number for m in reader.messages() if m.sensor == "oxts"] == [0, 1, 3]


def test_poses_of_fewer_frames(tracking_folder: Path) -> None:
    path = tracking_folder / "oxts/0000.txt"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    assert "poses: of frames 0 to 1, though the sequence has 4 frames" in run(tracking_folder, BadInput()).lines


def test_a_list_of_sequences_that_is_broken(tracking_folder: Path) -> None:
    (tracking_folder / "image_02/0000").rename(tracking_folder / "gone")
    (tracking_folder / "velodyne/0000").rename(tracking_folder / "gone2")
    (tracking_folder / "evaluate_tracking.seqmap.training").write_text("0000 empty 000000 many\n")
    refused(tracking_folder, r"seqmap.training line 1: frame is 'many', expected a whole number")


def test_object_frames_without_a_calibration_are_left_out(object_folder: Path) -> None:
    (object_folder / "calib/000000.txt").unlink()
    refused(object_folder, r"calib/000000.txt: can't be read")
    skipped(object_folder, 1)
    truths = open_log(object_folder.parent / "out.mcap", FaultLog()).truths()
    assert [t.frame_number for t in truths] == [1, 5]


def test_object_set_without_any_calibration(object_folder: Path) -> None:
    for path in (object_folder / "calib").iterdir():
        path.unlink()
    assert skipped(object_folder, 1).state == "failed"


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (CAR[:-4], r"label_2/000000.txt line 2: 13 numbers after the class, expected 14"),
        (CAR.replace("20", "inf"), r"label_2/000000.txt line 2: a number isn't finite"),
        ("Car", r"label_2/000000.txt line 2: 0 numbers after the class"),
    ],
)
def test_broken_object_labels(object_folder: Path, row: str, message: str) -> None:
    (object_folder / "label_2/000000.txt").write_text(f"{CAR}\n{row}\n")
    refused(object_folder, message)
    skipped(object_folder, 1)
    truth = next(iter(open_log(object_folder.parent / "out.mcap", FaultLog()).truths()))
    assert len(truth.boxes3d) == 1


def test_object_frames_of_other_folders(object_folder: Path) -> None:
    """A frame that only one folder has is a frame that misses the others."""
    (object_folder / "velodyne/000009.bin").write_bytes(bytes(16))
    refused(object_folder, r"calib/000009.txt: can't be read")
    skipped(object_folder, 1)


def test_object_labels_that_are_no_text(object_folder: Path) -> None:
    (object_folder / "label_2/000000.txt").write_bytes(b"\xff\xfe")
    refused(object_folder, r"label_2/000000.txt: isn't UTF-8 text")
    skipped(object_folder, 1)
    truths = open_log(object_folder.parent / "out.mcap", FaultLog()).truths()
    assert [t.frame_number for t in truths] == [1, 5]


@pytest.mark.parametrize("name", ["image_02/0000/000001.png", LABELS, CALIB])
def test_pipes_and_folders_in_place_of_files(tracking_folder: Path, name: str) -> None:
    path = tracking_folder / name
    path.unlink()
    os.mkfifo(path)
    refused(tracking_folder, rf"{path.name}: a pipe or device, expected a file$")
    path.unlink()
    path.mkdir()
    refused(tracking_folder, rf"{path.name}: Is a directory$")


def test_damaged_images(tracking_folder: Path) -> None:
    """Their headers and ends are whole; decoders would tell of it in words of their own, and later."""
    path = tracking_folder / "image_02/0000/000001.png"
    whole = path.read_bytes()
    at = whole.index(b"IDAT") + 12
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    refused(tracking_folder, r"000001.png: the image is damaged, a checksum in it is wrong$")
    assert skipped(tracking_folder, 1).written is not None


def test_images_beyond_all_reason(object_folder: Path) -> None:
    header = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    chunks = ((13, header), (0, b"IEND"))
    data = b"".join(struct.pack(">I", num) + body + struct.pack(">I", crc32(body)) for num, body in chunks)
    (object_folder / "image_2/000001.png").write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    refused(object_folder, r"000001.png: 60000x60000 px, expected 1 to [0-9]+ pixels$")
