"""Tables of nuScenes: their folder, small ones in memory, rows of large ones in a temporary database."""

import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeVar

from fbench.datasets.nuscenes.rows import (
    CalibratedSensor,
    Instance,
    Log,
    Named,
    Sample,
    Scene,
    Sensor,
    Visibility,
    parse_rows,
    read_by_token,
)
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.importing import require_folder


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


_ROWS: dict[str, type[PoseRow | DataRow | AnnotationRow]] = {
    "data": DataRow,
    "pose": PoseRow,
    "annotation": AnnotationRow,
}
_INDICES = {
    "data": "CREATE INDEX data_scene ON data(scene)",
    "pose": "CREATE UNIQUE INDEX pose_token ON pose(token)",
    "annotation": "CREATE INDEX annotation_scene ON annotation(scene)",
}
_BATCH = 10_000


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
            while batch := list(islice(rest, _BATCH)):
                self._sqlite.execute("BEGIN")
                self._sqlite.executemany(insert, batch)
                self._sqlite.execute("COMMIT")
            self._sqlite.execute(_INDICES[table])
        except sqlite3.IntegrityError as error:
            query = "SELECT token FROM pose GROUP BY token HAVING count(*) > 1 ORDER BY token LIMIT 1"
            token = self._sqlite.execute(query).fetchone()[0]
            raise LogError(f"{path}: two rows have the token '{token}'") from error
        except sqlite3.Error as error:
            raise LogError(f"the temporary file for the tables can't be written ({error}); see TMPDIR") from error

    def count(self, scene: int) -> int:
        """Number of rows of `sample_data`."""
        return int(self._sqlite.execute("SELECT count(*) FROM data WHERE scene = ?", (scene,)).fetchone()[0])

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


TABLES = (
    "scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor", "sample_annotation", "instance",
    "category", "attribute", "visibility", "log",
)  # fmt: skip
"""Those that an import reads."""


@dataclass(frozen=True)
class Folder:
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


T = TypeVar("T")


@dataclass(frozen=True)
class Tables:
    """Rows by token; looking up one that isn't there raises `LogError`, naming its table."""

    folder: Folder
    sensors: Mapping[str, Sensor]
    calibrations: Mapping[str, CalibratedSensor]
    categories: Mapping[str, str]  # Names of categories by token
    instances: Mapping[str, str]  # Tokens of categories by those of instances
    attributes: Mapping[str, str]  # Names by token
    visibilities: Mapping[str, str]  # Levels by token

    def calibration(self, token: str) -> CalibratedSensor:
        """Return where a sensor sits."""
        return self._find(self.calibrations, token, "calibrated_sensor")

    def sensor(self, calibration: CalibratedSensor) -> Sensor:
        """Return the sensor that a calibration is of."""
        return self._find(self.sensors, calibration.sensor_token, "sensor")

    def category(self, instance: str) -> str:
        """Return the name of an object's category."""
        return self._find(self.categories, self._find(self.instances, instance, "instance"), "category")

    def attribute(self, token: str) -> str:
        """Return its name."""
        return self._find(self.attributes, token, "attribute")

    def visibility(self, token: str) -> str:
        """Return its level."""
        return self._find(self.visibilities, token, "visibility")

    def _find(self, rows: Mapping[str, T], token: str, table: str) -> T:
        row = rows.get(token)
        if row is None:
            raise LogError(f"{self.folder.table(table)}: no row with token '{token}', which another table names")
        return row


def read_tables(folder: Folder) -> Tables:
    """Read them. Raises LogError where one is wrong."""
    return Tables(
        folder,
        read_by_token(Sensor, folder.table("sensor")),
        read_by_token(CalibratedSensor, folder.table("calibrated_sensor")),
        {token: row.name for token, row in read_by_token(Named, folder.table("category")).items()},
        {row.token: row.category_token for row in parse_rows(Instance, folder.table("instance"))},
        {token: row.name for token, row in read_by_token(Named, folder.table("attribute")).items()},
        {token: row.level for token, row in read_by_token(Visibility, folder.table("visibility")).items()},
    )


class Instant(NamedTuple):
    """One sample of a scene."""

    token: str
    stamp_us: int


class _Link(NamedTuple):
    scene: str
    stamp_us: int
    prev: str
    next: str


def read_scenes(folder: Folder) -> Mapping[str, Scene]:
    """Return the scenes by name, sorted. Raises LogError where the table is wrong, is empty, or two scenes have one
    name.
    """
    path = folder.table("scene")
    scenes: dict[str, Scene] = {}
    for scene in read_by_token(Scene, path).values():
        if scene.name in scenes:
            raise LogError(f"{path}: two scenes are called '{scene.name}', only one of them may be there")
        scenes[scene.name] = scene
    if not scenes:
        raise LogError(f"{path}: no scenes")
    return dict(sorted(scenes.items()))


@dataclass(frozen=True)
class Samples:
    """All samples of all scenes, and the drives that scenes come from."""

    path: Path
    links: Mapping[str, _Link]  # By token
    nums: Mapping[str, int]  # How many samples name a scene, by its token
    logs: Mapping[str, Log]

    def chain(self, scene: Scene) -> tuple[Instant, ...]:
        """Return the samples of a scene in the order of time. Raises LogError where the chain leaves the scene, loops,
        runs back in time, or isn't as the scene says.
        """
        found: list[Instant] = []
        token, prev = scene.first_sample_token, ""
        while token:
            link = self._link(scene, token, prev)
            if found and link.stamp_us <= found[-1].stamp_us:
                raise LogError(f"{self.path}: sample '{token}' isn't later than '{prev}', of which it is next")
            found.append(Instant(token, link.stamp_us))
            token, prev = link.next, token
        if prev != scene.last_sample_token or not len(found) == scene.nbr_samples == self.nums[scene.token]:
            there = f"links {len(found)} of its {self.nums[scene.token]} samples and ends with '{prev}'"
            expected = f"expected {scene.nbr_samples} that end with '{scene.last_sample_token}'"
            raise LogError(f"{self.path}: {scene.name} {there}, {expected}")
        return tuple(found)

    def _link(self, scene: Scene, token: str, prev: str) -> _Link:
        link = self.links.get(token)
        if link is None:
            raise LogError(f"{self.path}: no sample '{token}', which {scene.name} has")
        if link.scene != scene.token:
            raise LogError(f"{self.path}: sample '{token}' is of another scene than {scene.name}, which links it")
        if link.prev != prev:
            raise LogError(f"{self.path}: sample '{token}' follows '{link.prev}', but is next of '{prev}'")
        return link


def read_samples(folder: Folder) -> Samples:
    """Read `sample` and `log`. Raises LogError where a table is wrong."""
    path = folder.table("sample")
    links: dict[str, _Link] = {}
    for row in parse_rows(Sample, path):
        if row.token in links:
            raise LogError(f"{path}: two rows have the token '{row.token}'")
        links[row.token] = _Link(row.scene_token, row.timestamp, row.prev, row.next)
    return Samples(path, links, Counter(link.scene for link in links.values()), read_by_token(Log, folder.table("log")))
