"""Conditions of cameras."""
