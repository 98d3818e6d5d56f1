"""Fixtures that all tests share."""

from pathlib import Path

import pytest
from hypothesis import settings

# The same examples on every run, and no deadline: machines of CI are slow at times.
settings.register_profile("fbench", deadline=None, derandomize=True)
settings.load_profile("fbench")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared() -> Path:
    """Real recordings and weights, which aren't part of the project."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip(f"real recordings are not at {folder}")
    return folder
