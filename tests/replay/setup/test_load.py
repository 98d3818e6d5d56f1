"""An fbench.toml is untrusted input: every mistake in it is one line that names file and key."""

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.variants import MAX_BYTES
from fbench.replay.setup.configuration import load_config, setup_of

GOOD = """\
version = 1

[frames]
reference = "top"
timeout_ms = 45

[body]
frame = "base_link"
pose = "/odom"
outline_m = [3.9, 1, 0.95]

[sensors.top]
topic = "/lidar/points"
kind = "lidar"
offset_ms = -12.5

[sensors.front]
topic = "/radar"
kind = "radar"
doppler = "approaching"
ego_motion = "removed"
velocity_period_mps = 10.4
optional = true

[truth]
topics = ["/labels"]

[results]
topics = ["/tracks"]

[classes]
"Sedan (parked)" = "car"
DontCare = "ignore"
"""


def written(tmp_path, text):
    path = tmp_path / "fbench.toml"
    path.write_text(text)
    return path


def test_everything_that_is_written_is_understood(tmp_path):
    path = written(tmp_path, GOOD)
    config = load_config(path)
    setup = setup_of(config, path)
    assert (config.frames.reference, config.frames.timeout_ms, config.frames.tolerance_ms) == ("top", 45, 50)
    assert config.sensors["top"].offset_ms == -12.5
    front = setup.sensors["front"]
    assert (front.kind, front.doppler, front.ego_motion) == ("radar", "approaching", "removed")
    assert (front.velocity_period_mps, front.optional, setup.sensors["top"].optional) == (10.4, True, False)
    assert (setup.body, setup.pose, setup.outline_m) == ("base_link", "/odom", (3.9, 1.0, 0.95))
    assert (setup.truth_topics, setup.result_topics) == (("/labels",), ("/tracks",))
    assert dict(setup.classes) == {"Sedan (parked)": "car", "DontCare": "ignore"}


def test_an_empty_one_says_nothing(tmp_path):
    path = written(tmp_path, "version = 1\n")
    setup = setup_of(load_config(path), path)
    assert not setup.sensors
    assert setup.truth_topics is None
    assert setup.truth is None
    assert setup.outline_m is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"'version' is missing"),
        ("version = 2", r"'version': Input should be 1"),
        ("version = 1\nversion = 1", r"not TOML: .*overwrite"),
        ("version = 1\n[sensor.a]", r"'sensor' isn't known; did you mean 'sensors'\?"),
        ("version = 1\n[frames]\ntimeout = 3", r"'frames\.timeout' isn't known; did you mean 'timeout_ms'\?"),
        ("version = 1\n[frames]\ntimeout_ms = -1", r"'frames\.timeout_ms': .*greater than or equal to 0"),
        ("version = 1\n[frames]\ntimeout_ms = nan", r"'frames\.timeout_ms'"),
        ("version = 1\n[frames]\ntimeout_ms = '3'", r"'frames\.timeout_ms': Input should be a valid number"),
        ("version = 1\n[body]\noutline_m = [3, 1]", r"'body\.outline_m"),
        ("version = 1\n[body]\noutline_m = [3, 1, 0]", r"'body\.outline_m.*greater than 0"),
        ("version = 1\n[body]\noutline_m = [3, 1, nan]", r"'body\.outline_m"),
        ("version = 1\n[body]\noutline_m = 'wide'", r"'body\.outline_m"),
        ("version = 1\n[sensors.a]\ntopic = '/a'", r"'sensors\.a\.kind' is missing"),
        ("version = 1\n[sensors.a]\ntopic = '/a'\nkind = 'ladar'", r"'sensors\.a\.kind': Input should be 'camera'"),
        ("version = 1\n[sensors.a]\ntopic = ''\nkind = 'lidar'", r"'sensors\.a\.topic'"),
        ("version = 1\n[classes]\nCar = 'cars'", r"'Car' is to be 'cars', which is no label; did you mean 'car'\?"),
        ("version = 1\n[classes]\nCar = 3", r"'classes\.Car': Input should be a valid string"),
        ("a" * (MAX_BYTES + 1), r"larger than"),
        ("version = 1\nx = " + "[" * 5000 + "]" * 5000, r"not TOML"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_what_is_no_text_is_one_line(tmp_path):
    path = tmp_path / "fbench.toml"
    path.write_bytes(b"version = 1\n# \xff\n")
    with pytest.raises(ConfigError, match="not UTF-8"):
        load_config(path)
    with pytest.raises(ConfigError, match="not a regular file"):
        load_config(tmp_path)


@pytest.mark.parametrize("name", ["../outside.toml", "/etc/passwd", "below/../../outside.toml", "link.toml"])
@pytest.mark.parametrize("table", ["body", "truth", "results"])
def test_files_outside_of_the_folder_are_refused(tmp_path, name, table):
    (tmp_path / "outside.toml").write_text("")
    folder = tmp_path / "inside"
    folder.mkdir()
    (folder / "below").mkdir()
    (folder / "link.toml").symlink_to(tmp_path / "outside.toml")
    key = f'rig = ["{name}"]' if table == "body" else f'file = "{name}"'
    path = written(folder, f"version = 1\n[{table}]\n{key}\n")
    with pytest.raises(ConfigError, match="lies outside of its folder") as caught:
        setup_of(load_config(path), path)
    assert caught.value.code == "SEC002"


def test_a_file_that_is_missing_is_one_line(tmp_path):
    path = written(tmp_path, 'version = 1\n[truth]\nfile = "labels"\n')
    with pytest.raises(ConfigError, match="'labels': no such file or folder"):
        setup_of(load_config(path), path)


def test_a_file_below_is_found_from_anywhere(tmp_path):
    (tmp_path / "labels").mkdir()
    path = written(tmp_path, 'version = 1\n[truth]\nfile = "labels"\nformat = "kitti"\ncamera = "front"\n')
    source = setup_of(load_config(path), path).truth
    assert source is not None
    assert (source.path, source.format, source.camera) == (tmp_path / "labels", "kitti", "front")
