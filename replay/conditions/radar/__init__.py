"""Conditions of radars."""
