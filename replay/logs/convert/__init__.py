"""Turning one form of a log into another."""
