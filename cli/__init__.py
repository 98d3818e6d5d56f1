"""The command line: the only place that prints or exits. Heavy imports stay inside the command functions."""

from fbench.cli.app import main

__all__ = ["main"]
