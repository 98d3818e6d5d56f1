"""`fbench log import`, as a user calls it."""

import json
from pathlib import Path

import pytest


@pytest.mark.slow
def test_import_into_parquet_is_the_same_log(fbench, shared):
    for name in ("a.mcap", "a.parquet"):
        assert fbench("log", "import", "astyx", shared / "data" / "astyx", "-o", name).code == 0
        assert fbench("replay", name, "-p", "radar3d", "-o", f"{name}-run").code == 0
    runs = [json.loads(Path(f"{name}-run/manifest.json").read_text()) for name in ("a.mcap", "a.parquet")]
    assert runs[0]["log"]["digest"] == runs[1]["log"]["digest"]
    assert runs[0]["digest"] == runs[1]["digest"]


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("there.parquet", "there.parquet: exists already; choose another with --out, or --overwrite it"),
        ("a.bag", "a.bag: expected a name that ends in .mcap or .parquet"),
        ("no/a.parquet", "no/a.parquet: can't be written (no folder "),
    ],
)
def test_logs_that_cannot_be_written(fbench, out, message):
    Path("there.parquet").mkdir()
    result = fbench("log", "import", "astyx", ".", "-o", out)
    assert result.code == 2
    assert result.err.startswith(f"fbench: {message}")
