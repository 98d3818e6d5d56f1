"""The condition of the examples, as its user runs and tests it."""

import json
from pathlib import Path

from tests.cli.conftest import messages, truths, write_log
from tests.program import fbench

from fbench.replay.contracts.plugins import make_condition
from fbench.replay.contracts.testing import check_condition

DUST = f"{Path(__file__).resolve().parents[2]}/examples/dust.py:Dust"


def test_dust_keeps_what_conditions_promise():
    check_condition(lambda: make_condition(DUST))


def test_dust_takes_points_of_a_log(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    log = write_log(tmp_path / "car.mcap", [*messages(), *truths()])
    kept = []
    for severity in (1, 3, 5):
        out = tmp_path / f"run{severity}"
        assert fbench("replay", log, "-p", "lidar3d", "--condition", f"{DUST}:{severity}", "-o", out) == 0
        manifest = json.loads((out / "manifest.json").read_text())
        assert [entry["name"] for entry in manifest["conditions"]] == ["dust.py:Dust"]
        kept.append(manifest["effects"]["lidar"]["points_after"])
    assert kept[0] > kept[1] > kept[2] > 0
    assert "changed: lidar: 6 of 6 messages changed" in capsys.readouterr().out


def test_random_numbers_dont_depend_on_where_the_file_lies(tmp_path, monkeypatch):
    log = write_log(tmp_path / "car.mcap", [*messages(), *truths()])
    (tmp_path / "dust.py").write_text(Path(DUST.removesuffix(":Dust")).read_text())
    monkeypatch.chdir(tmp_path)
    for name, condition in (("here", "dust.py:Dust:3"), ("there", f"{DUST}:3")):
        assert fbench("replay", log, "-p", "lidar3d", "--condition", condition, "-o", name) == 0
    here, there = (json.loads((tmp_path / name / "manifest.json").read_text()) for name in ("here", "there"))
    assert here == there
