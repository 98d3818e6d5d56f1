"""What the command line says goes before the configuration, and that before what is usual."""

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.logs.setup import BoxSource
from fbench.replay.setup.source import LogRequest, log_source

TEXT = """\
version = 1
[frames]
reference = "top"
timeout_ms = 45
stamps = "log"
[sensors.top]
topic = "/points"
kind = "lidar"
offset_ms = 5
[sensors.front]
topic = "/radar"
kind = "radar"
[truth]
file = "labels.csv"
"""


@pytest.fixture
def log(tmp_path):
    (tmp_path / "labels.csv").write_text("")
    (tmp_path / "fbench.toml").write_text(TEXT)
    return tmp_path / "drive.mcap"


def test_the_one_beside_the_log_is_used(log):
    source = log_source(LogRequest(log))
    assert list(source.setup.sensors) == ["top", "front"]
    assert source.setup.truth == BoxSource(log.parent / "labels.csv")
    assert source.sync_params(None, None, None, None).timeout_ns == 45_000_000
    assert source.sync_params("front", 10.0, None, None).reference == "front"
    assert source.sync_params("front", 10.0, None, None).timeout_ns == 10_000_000
    assert source.sync_params(None, None, None, None).tolerance_ns == 50_000_000
    assert [(entry.role, entry.name) for entry in source.inputs] == [("config", "fbench.toml")]


def test_offsets_of_the_command_line_go_first(log):
    source = log_source(LogRequest(log))
    own = source.stamps(None, [])
    assert (own.source, dict(own.offsets_ns)) == ("log", {"top": 5_000_000})
    own.require_known(["front"])  # the configuration may tell of sensors that were left out
    given = source.stamps("header", ["top=-3", "front=1"])
    assert (given.source, dict(given.offsets_ns)) == ("header", {"front": 1_000_000, "top": -3_000_000})
    with pytest.raises(ConfigError, match="no such sensor"):
        given.require_known(["front"])


def test_it_can_be_left_out_or_replaced(log, tmp_path):
    assert not log_source(LogRequest(log, "none")).setup.sensors
    other = tmp_path / "other.toml"
    other.write_text("version = 1\n[frames]\nreference = 'front'\n")
    assert log_source(LogRequest(log, str(other))).frames.reference == "front"
    with pytest.raises(ConfigError, match=r"nothing\.toml: can't be read"):
        log_source(LogRequest(log, str(tmp_path / "nothing.toml")))


def test_truth_of_the_command_line_goes_first(log, tmp_path):
    asked = LogRequest(log, truth=BoxSource(tmp_path / "kitti", "kitti"))
    assert log_source(asked).setup.truth == BoxSource(tmp_path / "kitti", "kitti")


def test_requests_can_be_moved_to_another_folder(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = LogRequest(log.relative_to(tmp_path), "fbench.toml", [], BoxSource(log.relative_to(tmp_path)))
    moved = asked.absolute()
    assert (moved.path, moved.config) == (log, str(tmp_path / "fbench.toml"))
    assert moved.truth == BoxSource(log)
    assert LogRequest(log, "none").absolute().config == "none"
