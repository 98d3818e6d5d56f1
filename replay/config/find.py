"""Where the `fbench.toml` of a log is."""

from pathlib import Path

from fbench.replay.config.model import NAME


def config_place(log: Path) -> Path:
    """Return where the configuration of a log belongs: in a folder of parts or of rosbag2, else beside the log.

    A Parquet folder holds what its `log.json` lists and nothing else.
    """
    if log.name in ("log.json", "metadata.yaml"):
        log = log.parent
    inside = log.is_dir() and not (log / "log.json").is_file()
    return log / NAME if inside else log.parent / NAME


def found_config(log: Path) -> Path | None:
    """Return the configuration of a log, `None` where there is none."""
    place = config_place(log)
    return place if place.is_file() else None
