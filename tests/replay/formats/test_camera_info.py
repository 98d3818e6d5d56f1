"""camera_info YAML of ROS."""

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.formats.rig_files import open_rig_file

TEXT = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [700.5, 0.000000, 320.25, 0., 701., 240, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.2, 0.1, 1e-3, -2.E-4, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
"""


def read(folder, text):
    path = folder / "left.yaml"
    path.write_text(text)
    return open_rig_file(path)


def test_intrinsics(tmp_path):
    patch = read(tmp_path, TEXT)
    assert not patch.edges
    camera = patch.cameras["narrow_stereo/left"]
    assert camera.K.tolist() == [[700.5, 0, 320.25], [0, 701, 240], [0, 0, 1]]
    assert (camera.size_wh, camera.distortion_model) == ((640, 480), "plumb_bob")
    assert camera.distortion.tolist() == [-0.2, 0.1, 1e-3, -2e-4, 0]


def test_models_of_other_names(tmp_path):
    eight = (
        TEXT.replace("plumb_bob", "rational_polynomial").replace("cols: 5", "cols: 8").replace("-0.2,", "1,2,3,-0.2,")
    )
    assert read(tmp_path, eight).cameras["narrow_stereo/left"].distortion_model == "rational_polynomial"
    four = TEXT.replace("plumb_bob", "equidistant").replace("cols: 5", "cols: 4").replace("-0.2, ", "")
    assert read(tmp_path, four).cameras["narrow_stereo/left"].distortion_model == "fisheye"


def test_without_a_name_it_is_that_of_the_file(tmp_path):
    assert set(read(tmp_path, TEXT.replace("camera_name: narrow_stereo/left\n", "")).cameras) == {"left"}


BAD = {
    "no width": (TEXT.replace("image_width: 640\n", ""), "no 'image_width'"),
    "width": (TEXT.replace("640", "-640"), "image_width: expected a whole number"),
    "no matrix": (TEXT.replace("camera_matrix", "matrix"), "no 'camera_matrix' with rows, cols and data"),
    "eight": (TEXT.replace("700.5, ", ""), "camera_matrix.data: expected 9 numbers, got 8"),
    "rows": (TEXT.replace("rows: 3", "rows: 2", 1), "camera_matrix: expected 3x3, got 2x3"),
    "NaN": (TEXT.replace("700.5", "nan"), r"camera_matrix.data\[0\]: expected a finite number"),
    "not calibrated": (TEXT.replace("700.5, 0.000000, 320.25, 0., 701., 240, 0, 0, 1", "0,0,0,0,0,0,0,0,0"),
                       "left: the camera isn't calibrated"),
    "model": (TEXT.replace("plumb_bob", "scaramuzza"), "distortion_model: 'scaramuzza' isn't supported; there are"),
    "coefficients": (TEXT.replace("plumb_bob", "fisheye"), "'fisheye' has 4 coefficients, got 5"),
    "six": (TEXT.replace("cols: 5", "cols: 6").replace("-0.2", "1, -0.2"), "'plumb_bob' has 4 or 5 coeff.*, got 6"),
    "columns": (TEXT.replace("cols: 5", "cols: 4"), "distortion_coefficients: expected 1x5, got 1x4"),
    "model as list": (TEXT.replace("plumb_bob", "[a]"), "distortion_model: expected a text"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "match"), BAD.values(), ids=BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, text, match):
    with pytest.raises(ConfigError, match=match) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path}/left.yaml: ")
    assert "\n" not in str(caught.value)
