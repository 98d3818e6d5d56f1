"""Raw drives with files that can't be used: one line that names the file, or a count with --skip-bad."""

import pytest

from fbench.datasets.kitti import raw
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import FrameRange


def replaced(old, new):
    return lambda path: path.write_text(path.read_text().replace(old, new, 1))


def without(name):
    def change(path):
        path.write_text("".join(f"{s}\n" for s in path.read_text().splitlines() if not s.startswith(name)))

    return change


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("calib_cam_to_cam.txt", lambda path: path.unlink(), "No such file"),
        ("calib_velo_to_cam.txt", lambda path: path.unlink(), "no such file"),
        ("calib_cam_to_cam.txt", lambda path: path.write_bytes(b"R_rect_00: \xff\xfe"), "isn't UTF-8"),
        ("calib_cam_to_cam.txt", without("P_rect_02"), "no line 'P_rect_02:'"),
        ("calib_cam_to_cam.txt", without("R_rect_00"), "no line 'R_rect_00:'"),
        ("calib_cam_to_cam.txt", replaced("P_rect_02: 7", "P_rect_02: 7 7"), "P_rect_02: 13 numbers, expected 12"),
        ("calib_cam_to_cam.txt", replaced("P_rect_02: 7", "P_rect_02: nan"), "P_rect_02: holds a number that isn't"),
        ("calib_cam_to_cam.txt", replaced("P_rect_02: 7", "P_rect_02: 1e300"), "beyond all reason"),
        ("calib_cam_to_cam.txt", replaced("P_rect_02: 7", "P_rect_02: x"), "a value is 'x', expected a number"),
        ("calib_cam_to_cam.txt", replaced("P_rect_02: 7", "P_rect_02: 0"), "isn't of the form"),
        ("calib_cam_to_cam.txt", replaced("S_rect_02: 6 4", "S_rect_02: 6.5 4"), "6.5x4 is no size of an image"),
        ("calib_cam_to_cam.txt", replaced("S_rect_02: 6 4", "S_rect_02: -6 4"), "no size of an image"),
        ("calib_cam_to_cam.txt", replaced("R_rect_00: 9.99", "R_rect_00: 9.89"), "R_rect_00: isn't a rotation"),
        ("calib_velo_to_cam.txt", replaced("T: ", "T: 1 "), "T: 4 numbers, expected 3"),
        ("calib_velo_to_cam.txt", replaced("R: ", "R: -"), "isn't a rotation"),
        ("calib_imu_to_velo.txt", without("T"), "no line 'T:'"),
    ],
)
def test_calibration(drive, file, change, message):
    change(drive.date / file)
    with pytest.raises(LogError, match=f"2011_09_26/{file}: .*{message}"):
        drive.imported()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("D_02: -0.35", "D_02: -0.35 1", "D_02: 6 numbers, expected 5"),
        ("K_02: 9.6e+00 0", "K_02: 0 0", "K_02: isn't of the form"),
        ("T_02: 5.9", "T_02: inf 5.9", "T_02: 4 numbers"),
        ("S_02: 8 6", "S_02: 8 1e9", "S_02: holds|S_02: 8x1e"),
    ],
)
def test_calibration_of_an_extract(extract, old, new, message):
    replaced(old, new)(extract.date / "calib_cam_to_cam.txt")
    with pytest.raises(LogError, match=f"calib_cam_to_cam.txt: .*({message})"):
        extract.imported()


def write(content):
    return lambda path: path.write_bytes(content)


@pytest.mark.parametrize(
    ("sensor", "change", "message"),
    [
        ("velodyne_points", write(b"\0" * 17), "17 bytes aren't whole rows of 4 float32, is it truncated"),
        ("image_02", write(b"no image"), "neither a JPEG nor a PNG"),
        ("image_02", write(b""), "neither a JPEG nor a PNG"),
        ("image_02", lambda path: path.write_bytes(path.read_bytes()[:-20]), "the image has no end"),
        ("oxts", lambda path: path.write_text(path.read_text().rsplit(" ", 1)[0]), "29 values, expected 30"),
        ("oxts", replaced("116.4", "nan116.4"), "altitude is 'nan116.4"),
        ("oxts", lambda path: path.write_text(""), "0 rows, expected one"),
        ("oxts", write(b"\xff\xfe"), "isn't UTF-8"),
    ],
)
def test_measurements(drive, sensor, change, message):
    change(drive.file(sensor, 1))
    with pytest.raises(LogError, match=f"{sensor}/data/0000000001.[a-z]+: .*{message}"):
        drive.imported()
    found = drive.imported(skip=True)
    assert found.bad.num == 1
    assert message.partition("(")[0][:20] in found.bad.texts[0]
    assert len(found.messages) == 11


def test_images_of_another_size(drive):
    drive.file("image_00", 2).write_bytes(drive.content("image_00", ".png", 2, (8, 4)))
    with pytest.raises(LogError, match=r"image_00/data/0000000002.png: 8x4 px, expected 6x4 as the calibration"):
        drive.imported()
    found = drive.imported(skip=True)
    assert (found.bad.num, len(found.of("image_00"))) == (1, 2)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("1 2 3\n4 5 6\n", "rows of 3 numbers, expected 4"),
        ("1 2 3 4\n5 6 7\n", "number of columns changed"),
        ("1 2 3 x\n", "could not convert"),
    ],
)
def test_points_of_an_extract(extract, rows, message):
    extract.file("velodyne_points", 1).write_text(rows)
    with pytest.raises(LogError, match=f"0000000001.txt: .*{message}"):
        extract.imported()
    assert extract.imported(skip=True).bad.num == 1


def test_no_stamps(drive):
    drive.stamps("image_02").unlink()
    with pytest.raises(LogError, match=r"image_02/timestamps.txt: No such file"):
        drive.imported()
    found = drive.imported(skip=True)
    assert (found.bad.num, found.of("image_02"), len(found.messages)) == (1, [], 9)


@pytest.mark.parametrize(
    "stamp",
    ["25.95", "2011-09-26", "2011-13-26 13:02:25.95", "2011-09-26 25:02:25", "9999-09-26 13:02:25", "nan",
     "0001-01-01 00:00:00", "2011-09-26 13:02:25.9511993371", "2011-09-26T13:02:25", "x" * 10000],
)  # fmt: skip
def test_malformed_stamps(drive, stamp):
    path = drive.stamps("velodyne_points")
    first, _, third = path.read_text().splitlines()
    path.write_text(f"{first}\n{stamp}\n{third}\n")
    with pytest.raises(
        LogError, match=r"velodyne_points/timestamps.txt: line 2: '.*' is no stamp, expected one as 2011"
    ):
        drive.imported()
    found = drive.imported(skip=True)
    assert found.bad.num == 1
    assert [m.frame_number for m in found.of("velodyne")] == [0, 2]


def test_fewer_stamps_than_files(drive):
    path = drive.stamps("oxts")
    path.write_text(path.read_text().splitlines()[0] + "\n")
    with pytest.raises(LogError, match=r"oxts/timestamps.txt: 1 lines, no stamp for file 1"):
        drive.imported()
    found = drive.imported(skip=True)
    assert (found.bad.num, len(found.of("oxts"))) == (2, 1)


def test_an_empty_line_where_there_is_a_file(drive):
    path = drive.stamps("oxts")
    first, _, third = path.read_text().splitlines()
    path.write_text(f"{first}\n\n{third}\n")
    with pytest.raises(LogError, match=r"oxts/timestamps.txt: line 2: no stamp for file 1"):
        drive.imported()


def test_stamps_that_arent_text(drive):
    drive.stamps("oxts").write_bytes(b"\xff\xfe\n")
    with pytest.raises(LogError, match=r"oxts/timestamps.txt: isn't UTF-8"):
        drive.imported()


def test_the_first_pose_may_be_bad(drive):
    drive.file("oxts", 0).write_text("1 2 3")
    with pytest.raises(LogError, match=r"0000000000.txt: 3 values"):
        drive.imported()
    found = drive.imported(skip=True)
    assert (found.bad.num, len(found.of("oxts"))) == (1, 2)
    assert found.log.info.metadata["world.origin_lon_deg"] == "8.434010000000"


def test_no_measurements(drive):
    for sensor in ("image_00", "image_02", "velodyne_points"):
        for path in sorted((drive.folder / sensor / "data").iterdir()):
            path.unlink()
    with pytest.raises(
        LogError, match=r"drive_0001_sync: no image and no point cloud, expected files in image_00/data"
    ):
        drive.imported()


def test_two_files_of_one_number(drive):
    (drive.folder / "image_00" / "data" / "1.png").write_bytes(b"")
    with pytest.raises(LogError, match=r"image_00/data/1.png: has the number of 0000000001.png"):
        drive.imported()


def test_numbers_beyond_all_reason_are_other_files(drive):
    (drive.folder / "image_00" / "data" / "9999999999.png").write_bytes(b"")
    assert "image_00: 1 other files left out, such as 9999999999.png" in drive.imported().lines


@pytest.mark.parametrize("frames", [FrameRange(3), FrameRange(7, 9)])
def test_no_such_frames(drive, extract, frames):
    for made in (drive, extract):
        with pytest.raises(LogError, match=rf"no measurement in frames {frames}; there are 0 to 2"):
            made.imported(frames=frames)


def test_a_file_instead_of_a_folder(drive):
    assert [*raw.find_drives(drive.file("oxts", 0))] == []


def test_links_to_nowhere_are_not_taken_for_nothing(drive):
    drive.write_tracklets().unlink()
    (drive.folder / "tracklet_labels.xml").symlink_to("elsewhere.xml")
    with pytest.raises(LogError, match=r"tracklet_labels.xml: No such file or directory$"):
        drive.imported()
