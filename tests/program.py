"""The program as a user calls it, in this process."""

import sys
from contextlib import ExitStack

import pytest

from fbench.cli import main


def fbench(*args: object) -> int:
    """Call `fbench ARGS` and return its exit code; what it simulates is in cities that are kept for the next call."""
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setattr(sys, "argv", ["fbench", *map(str, args)])
        if args[:2] == ("log", "simulate"):
            from tests.kept_cities import shared_cities

            stack.enter_context(shared_cities())
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0)
    return 0
