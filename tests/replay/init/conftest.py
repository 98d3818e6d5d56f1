"""Running `fbench init` without its command line."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from fbench.replay.config.model import Config
from fbench.replay.faults import FaultLog
from fbench.replay.init.run import draft_of
from fbench.replay.init.write import write_toml

from .drive import Drive

Guess = Callable[[Drive | Path], tuple[Config, str]]


@pytest.fixture
def guess(tmp_path) -> Guess:
    """What is written for a log: read back, and as text."""

    def guessed(log: Drive | Path) -> tuple[Config, str]:
        path = log if isinstance(log, Path) else log.write(tmp_path / "log.mcap")
        text = write_toml(draft_of(path, tmp_path / "fbench.toml", FaultLog())).text
        return Config.model_validate(tomllib.loads(text)), text

    return guessed
