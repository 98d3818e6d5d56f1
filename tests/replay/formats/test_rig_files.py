"""Our own TOML form of calibration."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tests.replay.formats.rig_toml import rig_toml

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.formats.rig_files import open_rig_file
from fbench.replay.geometry.transforms import pose_matrix
from fbench.replay.logs.coordinate_frames import TransformTree

FULL = """\
# three ways to give a rotation
[sensors.top]
translation_m = [1, 0, 1.8]
rotation_xyzw = [0, 0, 0.7071, 0.7071]

[sensors."/radar/front"]
parent = "bumper"
translation_m = [0.1, 0, 0]
yaw_pitch_roll_deg = [90, 0, 0]

[frames.bumper]
matrix = [[-1, 0, 0, 3.5], [0, -1, 0, 0.0], [0, 0, 1, 0.5]]

[cameras.front]
fx = 700
fy = 710.5
cx = 319.5
cy = 239.5
size_wh = [640, 480]
distortion_model = "radtan"
distortion = [-0.3, 0.1, 0.001, 0]
"""


def read(folder, text, name="rig.toml"):
    path = folder / name
    path.write_text(text) if isinstance(text, str) else path.write_bytes(text)
    return open_rig_file(path)


def test_three_ways_to_give_a_rotation(tmp_path):
    patch = read(tmp_path, FULL)
    assert patch.edges["top"].parent == "body"
    assert patch.edges["top"].rotation_xyzw.tolist() == [0, 0, 0.7071, 0.7071]  # as it was given
    # The bumper looks back; a radar turned to its left looks to the right of the body: +x of it is -y of the body.
    translation, rotation = TransformTree(dict(patch.edges)).pose("/radar/front", "body")
    np.testing.assert_allclose(translation, [3.4, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(pose_matrix(translation, rotation)[:3, 0], [0, -1, 0], atol=1e-12)
    front = patch.cameras["front"]
    assert front.K.tolist() == [[700, 0, 319.5], [0, 710.5, 239.5], [0, 0, 1]]
    assert (front.size_wh, front.distortion_model) == ((640, 480), "plumb_bob")
    assert patch.places["bumper"].endswith("rig.toml")


@pytest.mark.parametrize("name", ["rig", "rig.txt", "rig.yaml"])
def test_content_tells_the_form(tmp_path, name):
    assert set(read(tmp_path, FULL, name).edges) == {"top", "/radar/front", "bumper"}


def test_angles_are_yaw_pitch_roll(tmp_path):
    text = "[sensors.a]\ntranslation_m = [0, 0, 0]\nyaw_pitch_roll_deg = [30, -20, 10]"
    got = Rotation.from_quat(read(tmp_path, text).edges["a"].rotation_xyzw).as_matrix()
    z, y, x = (Rotation.from_rotvec(np.radians(a) * np.eye(3)[i]).as_matrix() for a, i in ((30, 2), (-20, 1), (10, 0)))
    np.testing.assert_allclose(got, z @ y @ x, atol=1e-15)


def test_rounded_matrix_becomes_orthonormal(tmp_path):
    rotation = Rotation.from_euler("ZYX", [0.3, 0.2, 0.1]).as_matrix().round(4)
    rows = np.c_[rotation, [1, 2, 3]].tolist()
    edge = read(tmp_path, f"[sensors.a]\nmatrix = {rows}").edges["a"]
    made = Rotation.from_quat(edge.rotation_xyzw).as_matrix()
    np.testing.assert_allclose(made.T @ made, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(made, rotation, atol=2e-4)


POSE = "translation_m=[0,0,0]\nrotation_xyzw=[0,0,0,1]\n"
BAD = {
    "unknown table": ("[sensor.a]", r"unknown key 'sensor'; did you mean 'sensors'"),
    "unknown key": ("[sensors.a]\nrotation_xyz = [0,0,0,1]", r"unknown key 'sensors.a.rotation_xyz'; did you mean"),
    "unknown camera key": ("[cameras.a]\nsize_wh = [1, 1]\nk = []", r"unknown key 'cameras.a.k'; did you mean 'K'"),
    "no rotation": ("[sensors.a]\ntranslation_m = [0,0,0]", "sensors.a: expected one of rotation_xyzw, .* got none"),
    "two rotations": (
        "[sensors.a]\ntranslation_m = [0,0,0]\nrotation_xyzw = [0,0,0,1]\nyaw_pitch_roll_deg = [0,0,0]",
        "got rotation_xyzw and yaw_pitch_roll_deg",
    ),
    "no translation": ("[sensors.a]\nrotation_xyzw = [0,0,0,1]", "sensors.a: no translation_m"),
    "two translations": (
        "[sensors.a]\ntranslation_m = [0,0,0]\nmatrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0]]", "one too many",
    ),
    "wrong length": ("[sensors.a]\ntranslation_m = [0,0]\nrotation_xyzw = [0,0,0,1]", r"sensors.a.translation_m: List"),
    "NaN": ("[sensors.a]\ntranslation_m = [0,0,nan]\nrotation_xyzw = [0,0,0,1]", r"translation_m.2: .*finite"),
    "too large": (f"[sensors.a]\ntranslation_m = [0,0,1{'0' * 400}]\nrotation_xyzw = [0,0,0,1]", "translation_m.2"),
    "hexadecimal": (f"[cameras.a]\nwidth = 0x{'f' * 4000}", "cameras.a.width: a whole number beyond 64 bits"),
    "text": ('[sensors.a]\ntranslation_m = [0,0,"1"]\nrotation_xyzw = [0,0,0,1]', r"translation_m.2: .*number"),
    "true": ("[sensors.a]\ntranslation_m = [0,0,true]\nrotation_xyzw = [0,0,0,1]", r"translation_m.2: .*number"),
    "zero quaternion": ("[sensors.a]\ntranslation_m = [0,0,0]\nrotation_xyzw = [0,0,0,0]", "rotation_xyzw: is zero"),
    "no rotation matrix": ("[sensors.a]\nmatrix = [[1,0,0,0],[0,1,0,0],[0,0,1.1,0]]", "isn't orthonormal .* by 0.21"),
    "mirrors": ("[sensors.a]\nmatrix = [[1,0,0,0],[0,-1,0,0],[0,0,1,0]]", "mirrors"),
    "transposed": ("[sensors.a]\nmatrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[1,2,3,1]]", "last row 0 0 0 1"),
    "ragged": ("[sensors.a]\nmatrix = [[1,0,0,0],[0,1,0],[0,0,1,0]]", r"expected 4x4 or 3x4 numbers, got rows of \[4"),
    "overflow": ("[sensors.a]\nmatrix = [[1e300,0,0,0],[0,1e300,0,0],[0,0,1,0]]", r"a number below 1e\+09"),
    "loop": (
        f'[sensors.a]\nparent = "b"\n{POSE}[frames.b]\nparent = "a"\n{POSE}',
        "loop: a → b → a",
    ),
    "body": ("[frames.body]\ntranslation_m=[0,0,0]\nrotation_xyzw=[0,0,0,1]", "'body' is the root"),
    "twice": (
        f"[frames.a]\n{POSE}[sensors.a]\n{POSE}",
        "'a' is in .sensors. and in .frames.",
    ),
    "no K": ("[cameras.a]\nsize_wh = [1, 1]", "expected K, or fx, fy, cx and cy; got none"),
    "half of K": ("[cameras.a]\nsize_wh = [1, 1]\nfx = 1", "got fx"),
    "K twice": ("[cameras.a]\nsize_wh = [1, 1]\nK=[[1,0,0],[0,1,0],[0,0,1]]\nfx = 1", "got K, fx"),
    "no size": ("[cameras.a]\nK=[[1,0,0],[0,1,0],[0,0,1]]", "cameras.a.size_wh: Field required"),
    "size 0": ("[cameras.a]\nsize_wh = [0, 1]\nK=[[1,0,0],[0,1,0],[0,0,1]]", "size_wh.0: .*greater than 0"),
    "half a pixel": ("[cameras.a]\nsize_wh = [1.5, 1]\nK=[[1,0,0],[0,1,0],[0,0,1]]", "size_wh.0: .*integer"),
    "no focal length": ("[cameras.a]\nsize_wh = [1, 1]\nfx=0\nfy=1\ncx=0\ncy=0", "positive focal lengths, got 0 and 1"),
    "K transposed": ("[cameras.a]\nsize_wh = [1, 1]\nK=[[1,0,0],[0,1,0],[3,4,1]]", "is it transposed"),
    "K zero": ("[cameras.a]\nsize_wh = [1, 1]\nK=[[0,0,0],[0,0,0],[0,0,0]]", "isn't calibrated"),
    "coefficients": (
        '[cameras.a]\nsize_wh = [1, 1]\nfx=1\nfy=1\ncx=0\ncy=0\ndistortion_model="fisheye"\ndistortion=[1]',
        "'fisheye' has 4 coefficients, got 1",
    ),
    "no TOML": ("[sensors.a\n", "isn't TOML"),
    "key twice": ("[sensors.a]\nparent = 'a'\nparent = 'b'", "isn't TOML"),
    "deep": (f"a = {'[' * 20000}", "nested too deeply"),
    "not text": (b"[sensors.\xff]", "isn't TOML .not UTF-8 .invalid start byte at byte 9"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "match"), BAD.values(), ids=BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, text, match):
    with pytest.raises(ConfigError, match=match) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path}/rig.toml: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert caught.value.code in ("CFG003", "CAL001")


def test_files_that_are_none(tmp_path):
    with pytest.raises(ConfigError, match=r"none.toml: can't be read \(No such file"):
        open_rig_file(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="not a regular file"):
        open_rig_file(tmp_path)
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(ConfigError, match="not a regular file"):
        open_rig_file(tmp_path / "fifo")


@pytest.mark.parametrize(("start", "limit"), [(b"[sensors.a]\n", 16), (b"a: b\n", 16), (b"<robot>", 16)])
def test_a_large_file_is_refused_before_it_is_read(tmp_path, start, limit):
    path = tmp_path / "rig"
    with path.open("wb") as file:
        file.write(start)
        file.truncate(100 * 2**20)
    with pytest.raises(ConfigError, match=f"has more than {limit * 2**20} bytes"):
        open_rig_file(path)
    path.write_bytes(start + b"#" * 2**20)
    with pytest.raises(ConfigError, match=f"has more than {2**20} bytes|isn't XML"):
        open_rig_file(path)


number = st.floats(-1e6, 1e6) | st.sampled_from([0.0, -0.0, 0.1, 1e-300, 1 / 3, 5e-324])
three, four = st.lists(number, min_size=3, max_size=3), st.lists(number, min_size=4, max_size=4)
names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12).filter(lambda n: n != "body")
mounts = st.builds(
    lambda kind, t, q: Mount(kind, np.array(t), np.array(q)),
    st.sampled_from(["camera", "lidar", "radar"]),
    three,
    four.filter(lambda q: np.linalg.norm(q) > 1e-3),
)
models = st.sampled_from([("", 0), ("plumb_bob", 5), ("plumb_bob", 0), ("rational_polynomial", 8), ("omni", 3)])
cameras = st.builds(
    lambda f, c, size, model, d: CameraModel(
        np.array([[f[0], c[0], c[1]], [0, f[1], c[2]], [0, 0, 1]]), size, model[0], np.array(d[: model[1]])
    ),
    st.tuples(*[st.floats(1e-3, 1e6)] * 2),
    three,
    st.tuples(*[st.integers(1, 10**6)] * 2),
    models,
    st.lists(number, min_size=8, max_size=8),
)


@pytest.mark.slow
@given(st.dictionaries(names, mounts, max_size=3), st.dictionaries(names, cameras, max_size=2))
def test_a_rig_is_read_back_bit_for_bit(tmp_path_factory, some_mounts, some_cameras):
    rig = Rig(some_mounts, some_cameras)
    path = tmp_path_factory.getbasetemp() / "round.toml"
    path.write_text(rig_toml(rig), encoding="utf-8", newline="")
    patch = open_rig_file(path)
    kinds = {name: mount.kind for name, mount in rig.mounts.items()}
    got = {name: Mount(kinds[name], e.translation_m, e.rotation_xyzw) for name, e in patch.edges.items()}
    assert {e.parent for e in patch.edges.values()} <= {"body"}
    assert Rig(got, patch.cameras).list_changes(rig) == ()
    assert rig_toml(Rig(got, patch.cameras)) == rig_toml(rig)


@given(st.binary(max_size=80) | st.text(st.sampled_from("ab[]{}=.,\"'\n #0-<>:&*!"), max_size=60))
def test_arbitrary_content_gives_typed_errors(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "fuzz"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert "\n" not in reason(path)


def reason(path):
    try:
        open_rig_file(path)
    except ConfigError as error:
        return str(error)
    return ""


def test_the_example_of_the_docs(tmp_path):
    page = (Path(__file__).resolve().parents[3] / "docs/logs.md").read_text()
    text = next(block for block in re.findall(r"```toml\n(.*?)```", page, re.DOTALL) if "[sensors.top]" in block)
    patch = read(tmp_path, text)
    assert set(patch.edges) == {"top", "front_radar", "bumper"}
    assert patch.cameras["front"].distortion.size == 5
    # A camera that looks forward, as the page says.
    forward = Rotation.from_euler("ZYX", [-90, 0, -90], degrees=True).as_matrix()
    np.testing.assert_allclose(forward @ np.eye(3)[2], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(forward @ np.eye(3)[0], [0, -1, 0], atol=1e-15)
