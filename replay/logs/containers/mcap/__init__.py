"""Mcap."""
