"""Tables of nuScenes: their folder, small ones in memory, rows of large ones in a temporary database."""

import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeVar

from fbench.datasets.nuscenes import rows
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.importing import require_folder

T = TypeVar("T")
TABLES = (
    "scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor", "sample_annotation", "instance",
    "category", "attribute", "visibility", "log",
)  # fmt: skip
"""Those that an import reads."""


class PoseRow(NamedTuple):
    """A row of `ego_pose`; the quaternion is w, x, y, z."""

    token: str
    stamp_us: int
    x: float
    y: float
    z: float
    qw: float
    qx: float
    qy: float
    qz: float


class DataRow(NamedTuple):
    """A row of `sample_data`; `sample` counts within the scene."""

    scene: int
    stamp_us: int
    channel: str
    sample: int
    is_key: bool
    calibration: str
    filename: str
    width: int | None
    height: int | None
    token: str
    pose: str


class AnnotationRow(NamedTuple):
    """A row of `sample_annotation`; `sample` counts within the scene, attributes are parted by spaces."""

    scene: int
    sample: int
    token: str
    instance: str
    attributes: str
    visibility: str
    x: float
    y: float
    z: float
    width: float
    length: float
    height: float
    qw: float
    qx: float
    qy: float
    qz: float
    num_lidar_pts: int
    num_radar_pts: int
    prev: str
    next: str


_Row = PoseRow | DataRow | AnnotationRow
_ROWS: dict[str, type[_Row]] = {"data": DataRow, "pose": PoseRow, "annotation": AnnotationRow}
_INDICES = {
    "data": "INDEX data_scene ON data(scene)",
    "annotation": "INDEX annotation_scene ON annotation(scene)",
    "pose": "UNIQUE INDEX pose_token ON pose(token)",
}


class Database:
    """Rows by scene; gone when it is closed."""

    def __init__(self) -> None:
        # SQLite removes an unnamed database itself, also where the process is killed.
        self._sqlite = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        for pragma in ("journal_mode=OFF", "synchronous=OFF", "cache_size=-65536"):  # KiB
            self._sqlite.execute(f"PRAGMA {pragma}")
        for table, row in _ROWS.items():
            self._sqlite.execute(f"CREATE TABLE {table} ({', '.join(row._fields)})")

    def close(self) -> None:
        """Remove all rows."""
        self._sqlite.close()

    def fill(self, table: str, rows: Iterable[tuple[Any, ...]], path: Path) -> None:
        """Add all rows of a table, which come from a file; their tokens must differ where it is `pose`. Raises LogError
        where two poses have the same token, or the disk is full.
        """
        try:
            rest = iter(rows)
            insert = f"INSERT INTO {table} VALUES ({','.join('?' * len(_ROWS[table]._fields))})"  # noqa: S608
            while batch := list(islice(rest, 10_000)):
                self._sqlite.execute("BEGIN")
                self._sqlite.executemany(insert, batch)
                self._sqlite.execute("COMMIT")
            self._sqlite.execute(f"CREATE {_INDICES[table]}")
        except sqlite3.IntegrityError as error:
            query = "SELECT token FROM pose GROUP BY token HAVING count(*) > 1 ORDER BY token LIMIT 1"
            token = self._sqlite.execute(query).fetchone()[0]
            raise LogError(f"{path}: two rows have the token '{token}'") from error
        except sqlite3.Error as error:
            raise LogError(f"the temporary file for the tables can't be written ({error}); see TMPDIR") from error

    def data(self, scene: int) -> Iterator[tuple[DataRow, PoseRow | None]]:
        """Yield what sensors measured, with the pose, in the order of stamps, then names."""
        query = (
            "SELECT data.*, pose.* FROM data LEFT JOIN pose ON pose.token = data.pose WHERE scene = ? "
            "ORDER BY data.stamp_us, channel, data.token"
        )
        num = len(DataRow._fields)
        for row in self._sqlite.execute(query, (scene,)):
            yield DataRow._make(row[:num]), None if row[num] is None else PoseRow._make(row[num:])

    def annotations(self, scene: int) -> Iterator[AnnotationRow]:
        """Yield the boxes in the order of samples, then of the table."""
        query = "SELECT * FROM annotation WHERE scene = ? ORDER BY sample, rowid"
        return (AnnotationRow._make(row) for row in self._sqlite.execute(query, (scene,)))


class Folder(NamedTuple):
    """One version of the set."""

    root: Path  # Names of files in the tables are relative to it
    version: str  # Name of the folder with the tables

    def table(self, name: str) -> Path:
        """Path of a table."""
        return self.root / self.version / f"{name}.json"

    def file(self, name: str) -> Path:
        """Path of a file that a table names. Raises LogError where that is outside of the set."""
        pure = PurePosixPath(name)
        if not name or pure.is_absolute() or ".." in pure.parts or "\0" in name:
            raise LogError(f"{self.table('sample_data')}: filename '{name[:200]}' isn't a name within {self.root}")
        return self.root / pure


def open_folder(source: Path, version: str) -> Folder:
    """Find the tables in `source`, which is the set's folder or the one with the tables. Raises LogError where it is
    neither, or a table is missing. Raises ConfigError where there are several versions and none is chosen, or the
    chosen one isn't there.
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


class Table(dict[str, T]):
    """Rows by token; looking up one that isn't there raises LogError, naming the table."""

    def __init__(self, path: Path, content: Mapping[str, T]) -> None:
        super().__init__(content)
        self._path = path

    def __missing__(self, token: str) -> T:
        raise LogError(f"{self._path}: no row with token '{token}', which another table names")


class Tables:
    """The small tables. Raises LogError where one is wrong."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder

        def read(table: str, model: type[rows.R]) -> Table[rows.R]:
            return Table(folder.table(table), rows.read_by_token(model, folder.table(table)))

        self.sensors = read("sensor", rows.Sensor)
        self.calibrations = read("calibrated_sensor", rows.CalibratedSensor)
        self.categories = read("category", rows.Named)
        path = folder.table("instance")
        instances = {row.token: row.category_token for row in rows.parse_rows(rows.Instance, path)}
        self.instances = Table(path, instances)
        """Tokens of categories."""
        self.attributes = read("attribute", rows.Named)
        self.visibilities = read("visibility", rows.Visibility)

    def sensor(self, calibration: str) -> rows.Sensor:
        """The sensor that a calibration is of, by the latter's token."""
        return self.sensors[self.calibrations[calibration].sensor_token]
