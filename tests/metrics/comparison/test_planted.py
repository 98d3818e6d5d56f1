"""Ten planted regressions of a real pipeline on a log of the city: all are found, with their stage."""

from pathlib import Path

import pytest
from tests.city_log import write_city_log

from fbench.api import LogRequest, ReplayRequest, replay
from fbench.api.gates import CompareRequest, compare_sides
from fbench.replay.data.comparison import Comparison

PLANTED = {
    "small radius": (["lidar.cluster.eps_m=0.12"], "", "lidar"),
    "large radius": (["lidar.cluster.eps_m=3"], "", "lidar"),
    "many points": (["lidar.cluster.min_points=30"], "", "lidar"),
    "short range": (["lidar.max_range_m=12"], "", "lidar"),
    "high ground": (["lidar.ground.tolerance_m=1.2"], "", "lidar"),
    "few objects": (["fusion.min_score=0.9"], "", "fuse"),
    "narrow gate": (["tracking.association=distance", "tracking.gate_m=0.05", "tracking.gate_mps=0"], "", "track"),
    "late tracks": (["tracking.min_hits=12"], "", "track"),
    "shifted calibration": ([], "extrinsic.lidar:5", "lidar"),
    "dropped sensor": ([], "dropout.lidar:5@2s-8s", "frames"),
}
"""Settings, condition, and the first stage that differs."""
UNCHANGED = {"nothing": [], "other bits": ["lidar.cluster.eps_m=0.61"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planted")
    write_city_log(folder / "city.mcap", 10.0, 3)
    replay_into(folder, "base", [])
    return folder


def replay_into(folder: Path, name: str, settings: list[str], condition: str = "") -> Path:
    out = folder / name.replace(" ", "-")
    replay(
        ReplayRequest(LogRequest(folder / "city.mcap"), "late3d", settings, condition=condition, out=out, no_media=True)
    )
    return out


def compare(folder: Path, head: Path, labels: bool = True) -> Comparison:
    policy = folder / "gate.toml"
    policy.write_text("version = 1\n", encoding="utf-8")
    reference = "truth" if labels else "base"
    return compare_sides(CompareRequest(folder / "base", head, 0.0, policy if labels else None, reference))  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_regression_is_found_at_its_stage(folder: Path, name: str) -> None:
    settings, condition, stage = PLANTED[name]
    head = replay_into(folder, name, settings, condition)
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
