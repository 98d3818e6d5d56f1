import os
from pathlib import Path

import pytest

from fbench.api.suites.cells import Response
from fbench.api.suites.process import Worker
from fbench.replay.geometry.threads import VARIABLE, num_threads
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest


@pytest.mark.parametrize(("text", "num"), [("1", 1), (" 4 ", 4), ("0", 1), ("64", 64)])
def test_the_environment_says_how_many(text: str, num: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(VARIABLE, text)
    assert num_threads() == num


@pytest.mark.parametrize("text", [None, "", "many", "-2", "1.5"])
def test_else_one_for_each_processor(text: str | None, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    if text is not None:
        monkeypatch.setenv(VARIABLE, text)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 3, 5})
    assert num_threads() == 3


@pytest.mark.slow
def test_a_worker_of_a_suite_has_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "asked.py").write_text(
        "from fbench.api.suites.cells import RESPONSE, Response\n"
        "from fbench.replay.geometry.threads import num_threads\n"
        "input()\n"
        "print(RESPONSE.dump_json(Response(str(num_threads()))).decode(), flush=True)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv(VARIABLE, "7")
    worker = Worker("asked")
    try:
        assert worker.replay(
            ReplayRequest(LogRequest(tmp_path / "log.mcap"), "lidar3d", out=tmp_path / "run")
        ) == Response("1")
    finally:
        worker.close()
