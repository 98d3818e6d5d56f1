"""Variants as TOML files: what they hold, and everything that they may not."""

import os
from pathlib import Path

import pytest

from fbench.replay.contracts.errors import EXIT_USAGE, ConfigError
from fbench.replay.contracts.variants import MAX_BYTES, read_variant

WHOLE = """
name = "far-cars"
title = "LiDAR that looks far"
base = "lidar3d"
sensors = ["top*", "!rear"]
detect_every = 3

[parameters]
min_score = 0.25
lidar.max_range_m = 120
lidar.cluster.with_height = true

[parameters.lidar.cluster]
method = "dbscan"

[parameters.lidar.shape]
top_m = [2.2, 2.6]

[parameters."front.left"]
min_range_m = 1
"""


def write(folder, text):
    path = folder / "mine.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_whole_file(tmp_path):
    variant = read_variant(write(tmp_path, WHOLE.replace("lidar.cluster.with_height = true\n", "")))
    assert (variant.name, variant.base, variant.title) == ("far-cars", "lidar3d", "LiDAR that looks far")
    assert variant.sensors == ("top*", "!rear")
    assert dict(variant.settings) == {
        "detect_every": "3", "min_score": "0.25", "lidar.max_range_m": "120", "lidar.cluster.method": "dbscan",
        "lidar.shape.top_m": "2.2,2.6", "front.left.min_range_m": "1",
    }  # fmt: skip


def test_the_shortest_file_and_a_byte_order_mark(tmp_path):
    variant = read_variant(write(tmp_path, b'\xef\xbb\xbfname = "a"\nbase = "track"\n'))
    assert (variant.name, variant.title, variant.settings, variant.sensors) == ("a", "", (), ())


MINIMUM = 'name = "a"\nbase = "track"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'name' is missing"),
        ('name = "a"', "'base' is missing"),
        (WHOLE, "Cannot"),  # a table that is written twice, in the words of the TOML parser
        (MINIMUM + "x = 1", "'x' isn't known; there are: base, detect_every, name, parameters, sensors, title; param"),
        (MINIMUM + "sensor = ['a']", "'sensor' isn't known; did you mean 'sensors'?; parameters of the pipeline"),
        (MINIMUM + "[tracking]\nmax_missed = 3", "'tracking' isn't known; there are"),
        ('name = 5\nbase = "track"', "'name': Input should be a valid string"),
        ('name = "a"\nbase = ["track"]', "'base': Input should be a valid string"),
        ('name = "a"\nbase = ""', "'base': String should have at least 1 character"),
        (MINIMUM + "sensors = 'lidar'", "'sensors': Input should be a valid tuple"),
        (MINIMUM + "sensors = [1]", "'sensors.0': Input should be a valid string"),
        (MINIMUM + "sensors = ['']", "'sensors.0': String should have at least 1 character"),
        (MINIMUM + "detect_every = 2.5", "'detect_every': Input should be a valid integer"),
        (MINIMUM + "detect_every = '2'", "'detect_every': Input should be a valid integer"),
        (MINIMUM + "parameters = 3", "'parameters': Input should be a valid dictionary"),
        (MINIMUM + "detect_every = 2\nparameters.detect_every = 3", "'detect_every' is set twice"),
        (MINIMUM + "[parameters]\n'a.b' = 1\na.b = 2", "'a.b' is set twice"),
        (MINIMUM + "[parameters]\n'a=b' = 1", "'a=b': a parameter's name has no '='"),
        (MINIMUM + "[parameters]\na = 2026-01-01", "'a': expected text, a number, true or false, or a list of these"),
        (MINIMUM + "[parameters]\na = [[1]]", "'a': expected text, a number"),
        (MINIMUM + "[[parameters.a]]\nb = 1", "'a': expected text, a number"),
        (MINIMUM + f"[parameters]\na = 0x{'f' * 5000}", "parameters.a: a whole number beyond 64 bits"),
        (MINIMUM + f"detect_every = 0x{'f' * 5000}", "detect_every: a whole number beyond 64 bits"),
        (MINIMUM + f"[parameters]\na = {'9' * 5000}", "Exceeds the limit"),
        (MINIMUM + f"[parameters]\na = {'[' * 5000}", "nested too deeply"),
        (MINIMUM + f"[parameters]\n{'a.' * 600}a = 1", "line 4 has over 500 dots"),
        ("name = ", "Invalid value"),
        (b'name = "\xff"', "not UTF-8"),
        *((f'name = "{name}"\nbase = "track"', "'name': expected at most 60 letters, digits")
          for name in ("", "../a", "a/b", "a b", ".a", "ä", "a\\n", "a" * 61)),
        (f'name = "a"\nbase = "track"\ntitle = "{"x" * 201}"', "'title': String should have at most 200"),
        (b"#" * (MAX_BYTES + 1), "larger than 1048576 bytes, which no variant needs"),
    ],
)  # fmt: skip
def test_files_that_are_wrong(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        read_variant(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == EXIT_USAGE


def test_deep_tables_are_read(tmp_path):
    names = ".".join(["a"] * 400)
    assert read_variant(write(tmp_path, f"{MINIMUM}[parameters.{names}]\nb = 1")).settings == ((f"{names}.b", "1"),)


def test_what_is_no_file(tmp_path):
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    for path in (folder, pipe, Path("/dev/zero")):
        with pytest.raises(ConfigError, match=r": not a regular file; name the TOML file of a variant"):
            read_variant(path)
    with pytest.raises(ConfigError, match=r"absent\.toml: can't be read \(No such file or directory\)"):
        read_variant(tmp_path / "absent.toml")
    with pytest.raises(ConfigError, match="can't be read"):
        read_variant(tmp_path / f"{'a' * 300}.toml")
