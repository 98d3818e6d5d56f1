"""Calibration that is damaged: read, or refused in one line."""

import pytest
from tests.replay.mutations import complaint, mutated
from tests.replay.rigfiles.test_kalibr import CAM
from tests.replay.rigfiles.test_urdf import ROBOT

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.formats.rig_files import open_rig_file

OWN = """\
[sensors.lidar]
parent = "body"
translation_m = [1.0, 0, 1.8]
yaw_pitch_roll_deg = [1, 2, 3]
[cameras.front]
fx = 700.0
fy = 700.0
cx = 320.0
cy = 240.0
size_wh = [640, 480]
distortion_model = "plumb_bob"
distortion = [0.1, 0, 0, 0, 0]
"""
INFO = """\
image_width: 640
image_height: 480
camera_name: front
camera_matrix: {rows: 3, cols: 3, data: [700, 0, 320, 0, 700, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
VALID = {"a.toml": OWN, "a.urdf": ROBOT, "camchain.yaml": CAM.format(num=0), "front.yaml": INFO}


@pytest.mark.parametrize("name", VALID)
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path, name):
    path = tmp_path / name
    path.write_text(VALID[name])
    open_rig_file(path)
    for content in mutated(VALID[name].encode(), 200, seed=4):
        path.write_bytes(content)
        told = complaint(lambda: open_rig_file(path))
        assert told.isprintable()
        assert len(told) < 2000


def test_keys_of_many_parts_are_refused_before_they_are_parsed(tmp_path):
    (tmp_path / "a.toml").write_text(".".join("a" * 400_000) + " = 1")
    with pytest.raises(ConfigError, match="line 1 has over 500 dots"):
        open_rig_file(tmp_path / "a.toml")
