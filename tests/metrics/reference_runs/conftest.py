"""From files to a run, by the program itself."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.program import fbench

Rows = dict[tuple[str, ...], tuple[float | None, dict[str, float]]]


@pytest.fixture
def program() -> Callable[..., int]:
    return fbench


@pytest.fixture
def scored(tmp_path: Path) -> Callable[..., Rows]:
    """Rows of `fbench score`, by metric, class, matching and slice; must not fail."""

    def score(*args: object) -> Rows:
        out = tmp_path / "scores.json"
        out.unlink(missing_ok=True)
        assert fbench("score", *args, "-o", out) == 0
        rows = json.loads(out.read_text())
        return {(r["metric"], r["class"], r["matching"], r["slice"]): (r["value"], r["counts"]) for r in rows}

    return score
