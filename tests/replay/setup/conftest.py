"""Running `fbench init` without its command line."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.replay.setup.drive import Drive

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.setup.configuration import Config
from fbench.replay.setup.init import draft_of, write_toml

Guess = Callable[[Drive | Path], tuple[Config, str]]


@pytest.fixture
def guess(tmp_path) -> Guess:
    """What is written for a log: read back, and as text."""

    def guessed(log: Drive | Path) -> tuple[Config, str]:
        path = log if isinstance(log, Path) else log.write(tmp_path / "log.mcap")
        text = write_toml(draft_of(path, tmp_path / "fbench.toml", FaultLog())).text
        return Config.model_validate(tomllib.loads(text)), text

    return guessed
