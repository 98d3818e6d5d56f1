"""Turning public datasets into logs: what importers of all formats share."""
