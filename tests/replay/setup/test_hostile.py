"""An fbench.toml from somebody else, written to do harm; `tests/hostile` damages one, too."""

import os

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.setup.configuration import load_config, setup_of


def refused(tmp_path, text, match):
    path = tmp_path / "fbench.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=match) as caught:
        setup_of(load_config(path), path)
    assert len(str(caught.value)) < 2000


def test_whole_numbers_without_end_are_refused(tmp_path):
    refused(tmp_path, f"version = {'9' * 5000}", "not TOML: Exceeds the limit")


def test_keys_of_many_parts_are_refused_before_they_are_parsed(tmp_path):
    refused(tmp_path, ".".join("a" * 400_000) + " = 1", "line 1 has over 500 dots")


def test_long_names_do_not_make_long_errors(tmp_path):
    refused(tmp_path, f"version = 1\n{'a' * 900_000} = 1", r"fbench.toml: 'aaa.* \.\.\. .*aaa")


def test_a_hundred_files_with_calibration_are_enough(tmp_path):
    files = ", ".join(['"a.toml"'] * 101)
    refused(tmp_path, f"version = 1\n[body]\nrig = [{files}]", "at most 100 items")


def test_loops_of_links_and_links_out_of_the_folder_are_refused(tmp_path):
    os.symlink("loop", tmp_path / "loop")
    refused(tmp_path, 'version = 1\n[truth]\nfile = "loop"', "'loop' lies outside of its folder")
    labels = tmp_path / "labels"
    labels.mkdir()
    os.symlink("/etc/hostname", labels / "000000.txt")
    refused(tmp_path, 'version = 1\n[truth]\nfile = "labels"', "'labels' holds '000000.txt', a link out of its folder")


def test_what_would_block_is_refused(tmp_path):
    os.mkfifo(tmp_path / "fbench.toml")
    with pytest.raises(ConfigError, match="not a regular file"):
        load_config(tmp_path / "fbench.toml")


def test_offsets_leave_stamps_within_64_bits(tmp_path):
    sensor = '[sensors.a]\ntopic = "/a"\nkind = "lidar"\noffset_ms = 1e15'
    refused(tmp_path, f"version = 1\n{sensor}", "sensors.a.offset_ms.*less than or equal")
