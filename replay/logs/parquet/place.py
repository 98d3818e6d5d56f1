"""What a Parquet log may take the place of."""

from pathlib import Path

from fbench.replay.errors import ConfigError
from fbench.replay.logs.parquet import log_json


def require_replaceable(path: Path) -> None:
    """Let only a Parquet log be replaced.

    Raises:
        ConfigError: where there is something else.
    """
    if path.is_symlink() or (path.exists() and not _is_log(path)):
        raise ConfigError(f"{path}: exists and isn't a Parquet log, so it isn't replaced; choose another name")


def _is_log(path: Path) -> bool:
    if not (path / log_json.NAME).is_file():
        return False
    return all(file.name == log_json.NAME or file.suffix == ".parquet" for file in path.iterdir())
