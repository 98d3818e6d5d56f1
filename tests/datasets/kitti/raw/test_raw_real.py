"""Raw drives made of real measurements: those of the object benchmark, and of a log that another tool wrote."""

import numpy as np
import pytest

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.images import decode
from fbench.replay.geometry.camera import project_body
from fbench.replay.geometry.iou import corners
from fbench.replay.geometry.transforms import transform
from fbench.replay.logs.open import open_log

SIZES = {0: (1224, 370), 1: (1242, 375), 2: (1242, 375)}


def write_calibration(folder, path, size_wh):
    """Write the numbers of the object benchmark as those of a date."""
    texts = dict(line.split(":", 1) for line in path.read_text().splitlines() if line.strip())
    lines = [f"R_rect_00:{texts['R0_rect']}"]
    for i in range(4):
        lines += [f"S_rect_{i:02d}: {size_wh[0]:e} {size_wh[1]:e}", f"P_rect_{i:02d}:{texts[f'P{i}']}"]
    (folder / "calib_cam_to_cam.txt").write_text("\n".join(lines))
    for name, key in (("calib_velo_to_cam.txt", "Tr_velo_to_cam"), ("calib_imu_to_velo.txt", "Tr_imu_to_velo")):
        rows = np.array(texts[key].split()).reshape(3, 4)
        (folder / name).write_text(f"R: {' '.join(rows[:, :3].flat)}\nT: {' '.join(rows[:, 3])}\n")
    return {key: np.array(text.split(), float) for key, text in texts.items()}


def square(matrix):
    whole = np.eye(4)
    whole[: matrix.shape[0], : matrix.shape[1]] = matrix
    return whole


def camera_T_velo_of(numbers):
    return square(numbers["R0_rect"].reshape(3, 3)) @ square(numbers["Tr_velo_to_cam"].reshape(3, 4))


def label_rows(path):
    rows = (line.split() for line in path.read_text().splitlines())
    return [(row[0], np.array(row[1:], float)) for row in rows if row[0] != "DontCare"]


def plain_counts(rows, points, camera_T_velo):
    """Points in each labeled box, in the camera's coordinates, where boxes turn about y."""
    camera = (camera_T_velo @ np.column_stack([points[:, :3].astype(float), np.ones(len(points))]).T)[:3].T
    counts = []
    for _, v in rows:
        h, w, length, ry = v[7], v[8], v[9], v[13]
        d = camera - v[10:13]
        x = np.cos(ry) * d[:, 0] - np.sin(ry) * d[:, 2]
        z = np.sin(ry) * d[:, 0] + np.cos(ry) * d[:, 2]
        counts.append(int(((abs(x) <= length / 2) & (abs(z) <= w / 2) & (d[:, 1] <= 0) & (d[:, 1] >= -h)).sum()))
    return counts


def tracklet_pose(drive, v, velo_T_camera):
    """The box of a label in LiDAR coordinates, with all three angles."""
    x, y, z = (velo_T_camera @ [*v[10:13], 1])[:3]
    ry = v[13]
    # Axes of the box: along its length, to its left, and up; the camera's y is down.
    axes = np.array([[np.cos(ry), 0, -np.sin(ry)], [np.sin(ry), 0, np.cos(ry)], [0, -1, 0]]).T
    R = velo_T_camera[:3, :3] @ axes
    rz, rx, pitch = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0])
    text = drive.pose.format(x, y, z, rz, 2, int(v[1]), v[0])
    return text.replace("<rx>0<", f"<rx>{rx}<").replace("<ry>0<", f"<ry>{pitch}<")


def keep_frames(drive, num):
    for sensor in ("image_00", "image_02", "velodyne_points", "oxts"):
        for path in sorted((drive.folder / sensor / "data").iterdir()):
            if sensor in ("image_00", "oxts") or int(path.stem) >= num:
                path.unlink()


def points_inside(found):
    """Points in each box, both in body coordinates; corner i differs from j along one edge where i ^ j is 1, 2, 4."""
    cloud, boxes = found.of("velodyne")[0], found.truths[0].boxes3d
    xyz = transform(found.log.rig.body_T_sensor("velodyne"), cloud.xyz)
    counts = []
    for eight in corners(boxes):
        edges = np.stack([eight[i] - eight[0] for i in (1, 2, 4)])
        shares = (xyz - eight[0]) @ np.linalg.inv(edges)
        counts.append(int(((shares >= 0) & (shares <= 1)).all(axis=1).sum()))
    return counts


@pytest.mark.parametrize("frame", [0, 1, 2])
def test_points_are_in_the_boxes_that_they_were_labeled_in(shared, drive, make_tracklet, frame):
    source = shared / "data" / "kitti_object"
    numbers = write_calibration(drive.date, source / f"calib/{frame:06d}.txt", SIZES[frame])
    keep_frames(drive, 1)
    cloud = (source / f"velodyne/{frame:06d}.bin").read_bytes()
    drive.file("velodyne_points", 0).write_bytes(cloud)
    drive.file("image_02", 0).write_bytes((source / f"image_2/{frame:06d}.png").read_bytes())
    rows = label_rows(source / f"label_2/{frame:06d}.txt")
    camera_T_velo = camera_T_velo_of(numbers)
    velo_T_camera = np.linalg.inv(camera_T_velo)
    drive.write_tracklets(
        *(
            make_tracklet([tracklet_pose(drive, v, velo_T_camera)], name, hwl=f"{v[7]} {v[8]} {v[9]}")
            for name, v in rows
        )
    )
    found = drive.imported()
    expected = plain_counts(rows, np.frombuffer(cloud, "<f4").reshape(-1, 4), camera_T_velo)
    assert points_inside(found) == expected
    if frame == 0:
        assert expected == [376]
    assert sum(expected) > 0
    boxes = found.truths[0].boxes3d
    np.testing.assert_allclose(boxes.center_m[:, 0], [v[12] for _, v in rows], atol=1e-4)
    assert np.abs([boxes.roll_rad, boxes.pitch_rad]).max() < 1e-6  # labels stand upright in the body's coordinates


def test_a_log_of_another_tool_has_the_same_calibration(shared, drive):
    """kitti2mcap wrote poses of sensors and K from a date's calibration, which is that of object frame 000001. For the
    camera's position it takes P[0, 3] / fx as the whole offset, so that it is 3 mm off.
    """
    other = open_log(shared / "data" / "mcap" / "kitti_raw_12frames_ros2.mcap", FaultLog())
    write_calibration(drive.date, shared / "data" / "kitti_object" / "calib" / "000001.txt", (1242, 375))
    messages = list(other.messages())
    camera = next(name for name, mount in other.rig.mounts.items() if mount.kind == "camera")
    lidar = next(name for name, mount in other.rig.mounts.items() if mount.kind == "lidar")
    clouds = [m for m in messages if m.sensor == lidar][:2]
    images = [m for m in messages if m.sensor == camera][:2]
    keep_frames(drive, 2)
    for i, (cloud, image) in enumerate(zip(clouds, images, strict=True)):
        write_measurements(drive, i, cloud, decode(image))
    found = drive.imported()
    for got, cloud in zip(found.of("velodyne"), clouds, strict=True):
        np.testing.assert_array_equal(got.xyz, cloud.xyz)
        np.testing.assert_array_equal(got.intensity, cloud.intensity)
    for got, image in zip(found.of("image_02"), images, strict=True):
        np.testing.assert_array_equal(decode(got), decode(image))
    rig = found.log.rig
    np.testing.assert_array_equal(rig.cameras["image_02"].K, other.rig.cameras[camera].K)
    assert rig.cameras["image_02"].size_wh == other.rig.cameras[camera].size_wh
    mine = np.linalg.inv(rig.body_T_sensor("image_02")) @ rig.body_T_sensor("velodyne")
    theirs = np.linalg.inv(other.rig.body_T_sensor(camera)) @ other.rig.body_T_sensor(lidar)
    np.testing.assert_allclose(mine[:3, :3], theirs[:3, :3], atol=1e-6)
    np.testing.assert_allclose(mine[:3, 3], theirs[:3, 3], atol=0.004)
    ahead = clouds[0].xyz[clouds[0].xyz[:, 0] > 10]
    pixels = [
        project_body(r, c, transform(r.body_T_sensor(s), ahead))[0]
        for r, c, s in ((rig, "image_02", "velodyne"), (other.rig, camera, lidar))
    ]
    assert np.abs(pixels[0] - pixels[1]).max() < 0.5


def write_measurements(drive, number, cloud, pixels):
    import cv2

    rows = np.column_stack([cloud.xyz, cloud.intensity]).astype("<f4")
    drive.file("velodyne_points", number).write_bytes(rows.tobytes())
    drive.file("image_02", number).write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
