"""Tests of containers and codecs."""
