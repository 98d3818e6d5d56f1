"""Tests of `fbench.replay.logs.convert`."""
