"""The program as a user calls it, in this process."""

import sys

import pytest

from fbench.replay.cli import main


def fbench(*args: object) -> int:
    """Call `fbench ARGS` and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["fbench", *map(str, args)])
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0)
    return 0
