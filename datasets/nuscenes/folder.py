"""Where the tables of nuScenes lie, and the files that they name."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from fbench.replay.errors import ConfigError, LogError
from fbench.replay.imports.files import require_folder

TABLES = (
    "scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor", "sample_annotation", "instance",
    "category", "attribute", "visibility", "log",
)  # fmt: skip
"""Those that an import reads."""


@dataclass(frozen=True)
class Folder:
    """One version of the set."""

    root: Path
    """Names of files in the tables are relative to it."""
    version: str
    """Name of the folder with the tables."""

    def table(self, name: str) -> Path:
        """Path of a table."""
        return self.root / self.version / f"{name}.json"

    def file(self, name: str) -> Path:
        """Path of a file that a table names.

        Raises:
            LogError: where that is outside of the set.
        """
        pure = PurePosixPath(name)
        if not name or pure.is_absolute() or ".." in pure.parts or "\0" in name:
            raise LogError(f"{self.table('sample_data')}: filename '{name[:200]}' isn't a name within {self.root}")
        return self.root / pure


def open_folder(source: Path, version: str) -> Folder:
    """Find the tables in `source`, which is the set's folder or the one with the tables.

    Raises:
        LogError: where it is neither, or a table is missing.
        ConfigError: where there are several versions and none is chosen, or the chosen one isn't there.
    """
    require_folder(source)
    if (source / "scene.json").is_file():
        own = source.resolve()
        folder, known = Folder(own.parent, own.name), [own.name]
    else:
        known = sorted(path.name for path in source.glob("v1.0-*") if path.is_dir())
        if not known:
            raise LogError(f"{source}: not a nuScenes folder, no folder such as v1.0-mini and no scene.json")
        folder = Folder(source, version or known[0])
    if version and version not in known:
        raise ConfigError(f"{source}: no version '{version}'; there are: {', '.join(known)}")
    if not version and len(known) > 1:
        raise ConfigError(f"{source}: several versions, choose one with --set version=NAME: {', '.join(known)}")
    for name in TABLES:
        if not folder.table(name).is_file():
            raise LogError(f"{folder.table(name)}: no such table")
    return folder
