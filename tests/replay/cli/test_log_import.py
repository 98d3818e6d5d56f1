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


def test_a_log_that_is_there_is_not_replaced(fbench, shared):
    Path("there.parquet").mkdir()
    result = fbench("log", "import", "astyx", shared / "data" / "astyx", "-o", "there.parquet")
    assert result.code == 2
    assert result.err.startswith("fbench: there.parquet: exists already; choose another with --out, or --overwrite it")


def test_a_folder_that_is_not_there(fbench):
    result = fbench("log", "import", "astyx", ".", "-o", "no/a.parquet")
    assert result.code == 2
    assert result.err.startswith("fbench: no/a.parquet: can't be written (no folder ")


def test_logs_do_not_go_into_a_file(fbench):
    Path("a.bag").touch()
    result = fbench("log", "import", "astyx", ".", "-o", "a.bag")
    assert result.code == 2
    assert result.err.startswith(
        "fbench: a.bag: is a file; expected a name that ends in .mcap or .parquet, or a folder"
    )
