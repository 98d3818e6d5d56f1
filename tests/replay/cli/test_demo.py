"""`fbench demo`."""

from pathlib import Path

import pytest


@pytest.mark.slow
def test_demo_replays_three_pipelines_and_can_be_repeated(fbench):
    for _ in range(2):
        result = fbench("demo", "-o", "demo")
        assert result.code == 0
        assert "report: demo/report.html" in result.out
    for name in ("city.mcap", "report.html", "lidar3d/scores.json", "radar3d/scores.json", "late3d/scores.json"):
        assert (Path("demo") / name).is_file()
