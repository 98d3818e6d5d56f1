"""Logs as Parquet: a folder with `log.json` and one file a stream."""
