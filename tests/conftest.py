"""Fixtures that all tests share."""

import gc
import signal
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# The same examples on every run, and no deadline: machines of CI are slow at times.
settings.register_profile("fbench", deadline=None, derandomize=True)
settings.load_profile("fbench")

# What a shell starts in the background ignores Ctrl-C, and so would every program that tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

LONGEST = (
    "test_docs.py", "test_traffic_long.py", "test_verify.py", "test_every_pipeline_on_recordings.py",
    "test_city_recording.py", "test_city_cli.py", "test_environment.py", "test_every_pipeline.py", "test_bench.py",
    "test_interrupt.py", "test_demo.py", "test_hostile.py", "test_isolate.py", "test_truth_clock.py", "test_cpp.py",
    "test_two_processes.py", "test_browser.py",
)  # fmt: skip
"""Files that take more than half a minute. They come first, or else one processor would end with them alone."""

CITY = "tests/datasets/city"
"""Its session fixtures build several cities, which takes half a minute."""

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared() -> Path:
    """Real recordings and weights, which aren't part of the project."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip(f"real recordings are not at {folder}")
    return folder


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each file to one process, and all files that look at the same simulated logs to the same one."""
    if config.getvalue("dist") != "loadfile":
        return None
    scheduling = import_module("xdist.scheduler").LoadFileScheduling(config, log)
    file_of = scheduling._split_scope
    scheduling._split_scope = lambda nodeid: CITY if nodeid.startswith(f"{CITY}/") else file_of(nodeid)
    return scheduling


def pytest_collection_finish() -> None:
    """Let the garbage collector leave alone what was imported and collected: each look at it takes half a second."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    order = {name: i for i, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.name, len(order)))
