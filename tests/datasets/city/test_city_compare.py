"""Runs on one scene under two conditions are compared; runs on two scenes aren't."""

import json
from dataclasses import replace

import pytest
from tests.city_log import SMALL_RIG
from tests.kept_cities import kept
from tests.program import fbench as run

from fbench.datasets.city.recording import Cities, CityRecording
from fbench.datasets.city.rig import RigSpec
from fbench.datasets.city.spec import CitySpec, condition
from fbench.datasets.importing.run import write_recording
from fbench.replay.logs.convert.target import Target


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """Simulate and replay under a condition, each once; returns the run's folder."""
    folder = tmp_path_factory.mktemp("compare")

    def call(name, loss=0.0, cities=None):
        out = folder / f"{name}-run"
        if not out.exists():
            lidar = SMALL_RIG.lidars["lidar"].model_copy(update={"loss": loss})
            spec = CitySpec("urban", condition(name), 1.0, 3, RigSpec(lidars={"lidar": lidar}, pose_rate_hz=10.0))
            write_recording(
                CityRecording(spec, name, cities=cities or kept()), Target(folder / f"{name}.mcap"), lambda *_: None
            )
            assert run("replay", folder / f"{name}.mcap", "-p", "lidar3d", "-o", out) == 0
        return out

    return call


@pytest.fixture
def compared(replayed, capsys):
    """Compare two conditions: exit code, output, errors."""

    def call(base, head, loss=0.0, as_json=False):
        runs = replayed(base), replayed(head, loss)
        capsys.readouterr()
        code = run("compare", *runs, "--tolerance", "1", *(["--json"] if as_json else []))
        return code, *capsys.readouterr()

    return call


def test_conditions_are_compared_on_one_scene(compared):
    code, out, err = compared("clear", "fog")
    assert (code, err) == (0, "")
    assert "note: condition: clear -> fog\n" in out
    assert "note: weather.visibility_m: 20000 -> 100\n" in out
    assert "note: frames" not in out
    assert "at instants that" not in out
    assert "other numbers: " in out


def test_numbers_without_a_value_in_both_runs_are_only_counted(compared):
    rows = json.loads(compared("clear", "fog", as_json=True)[1])["rows"]
    empty = [row for row in rows if row["base"] is None and row["head"] is None and not row["primary"]]
    lines = compared("clear", "fog")[1].splitlines()
    assert empty
    assert any(f", {len(empty)} have no value in either run" in line for line in lines)
    assert not any("–      –" in line for line in lines)


def test_frames_that_a_sensor_lost_are_told(compared):
    code, out, err = compared("clear", "rain", loss=0.3)
    assert (code, err) == (0, "")
    assert "frames are at instants that base alone has" in out
    assert "that head alone has" not in out


class NormalCities(Cities):
    """Without the dense traffic, which takes long to build: that it is another scene is told from metadata alone."""

    def of(self, spec):
        return kept().of(replace(spec, condition=condition("clear")))


def test_other_traffic_is_another_scene(replayed, capsys):
    runs = replayed("clear"), replayed("traffic", loss=0.3, cities=NormalCities())
    capsys.readouterr()
    code = run("compare", *runs)
    out, err = capsys.readouterr()
    assert (code, out) == (3, "")
    assert "different logs can't be compared: base is 'clear'" in err
