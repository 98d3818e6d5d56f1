"""Planted regressions of a real pipeline on a log of the city: they are found, with the stage that they come from."""

from pathlib import Path

import pytest
from tests.city_log import write_city_log

from fbench.api import LogRequest, ReplayRequest, replay
from fbench.api.gates import CompareRequest, compare_sides
from fbench.replay.data.comparison import Comparison

PLANTED = {
    "small radius": (["lidar.cluster.eps_m=0.12"], "lidar"),
    "many points": (["lidar.cluster.min_points=30"], "lidar"),
    "short range": (["lidar.max_range_m=12"], "lidar"),
    "high ground": (["lidar.ground.tolerance_m=1.2"], "lidar"),
    "narrow gate": (["tracking.association=distance", "tracking.gate_m=0.05", "tracking.gate_mps=0"], "track"),
}
"""Settings, and the first stage that differs."""
UNCHANGED: dict[str, list[str]] = {"nothing": [], "other bits": ["lidar.cluster.eps_m=0.61"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planted")
    write_city_log(folder / "city.mcap", 10.0, 3)
    replay_into(folder, "base", [])
    return folder


def replay_into(folder: Path, name: str, settings: list[str]) -> Path:
    out = folder / name.replace(" ", "-")
    replay(ReplayRequest(LogRequest(folder / "city.mcap"), "late3d", settings, out=out, no_media=True))
    return out


def compare(folder: Path, head: Path, labels: bool = True) -> Comparison:
    policy = folder / "gate.toml"
    policy.write_text("version = 1\n", encoding="utf-8")
    reference = "truth" if labels else "base"
    return compare_sides(CompareRequest(folder / "base", head, 0.0, policy if labels else None, reference))  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_regression_is_found_at_its_stage(folder: Path, name: str) -> None:
    settings, stage = PLANTED[name]
    head = replay_into(folder, name, settings)
    found = compare(folder, head)
    first = found.divergences[0]
    bad = [row for row in found.rows if row.verdict == "REGRESSED"]
    assert found.is_worse
    assert first.stage == stage
    assert any(row.gate for row in bad)
    assert found.objects
    assert compare(folder, head, labels=False).divergences == found.divergences


@pytest.mark.slow
@pytest.mark.parametrize("name", UNCHANGED)
def test_what_is_as_good_is_no_regression(folder: Path, name: str) -> None:
    found = compare(folder, replay_into(folder, name, UNCHANGED[name]))
    assert found.state == "identical" if name == "nothing" else not found.is_worse
