"""Tables that an import holds in memory: scenes and the chains of their samples."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

from fbench.datasets.nuscenes.database import Folder
from fbench.datasets.nuscenes.rows import (
    CalibratedSensor,
    Instance,
    Log,
    Named,
    Sample,
    Scene,
    Sensor,
    Visibility,
    by_token,
    parsed_rows,
)
from fbench.replay.contracts.errors import LogError

T = TypeVar("T")


@dataclass(frozen=True)
class Tables:
    """Rows by token; what isn't there is told when it is needed."""

    folder: Folder
    sensors: Mapping[str, Sensor]
    calibrations: Mapping[str, CalibratedSensor]
    categories: Mapping[str, str]
    """Names of categories by token."""
    instances: Mapping[str, str]
    """Tokens of categories by those of instances."""
    attributes: Mapping[str, str]
    """Names by token."""
    visibilities: Mapping[str, str]
    """Levels by token."""

    def calibration(self, token: str) -> CalibratedSensor:
        """Return where a sensor sits.

        Raises:
            LogError: where that isn't known.
        """
        return self._found(self.calibrations, token, "calibrated_sensor")

    def sensor(self, calibration: CalibratedSensor) -> Sensor:
        """Return the sensor that a calibration is of.

        Raises:
            LogError: where it isn't known.
        """
        return self._found(self.sensors, calibration.sensor_token, "sensor")

    def category(self, instance: str) -> str:
        """Return the name of an object's category.

        Raises:
            LogError: where it isn't known.
        """
        return self._found(self.categories, self._found(self.instances, instance, "instance"), "category")

    def attribute(self, token: str) -> str:
        """Return its name.

        Raises:
            LogError: where it isn't known.
        """
        return self._found(self.attributes, token, "attribute")

    def visibility(self, token: str) -> str:
        """Return its level.

        Raises:
            LogError: where it isn't known.
        """
        return self._found(self.visibilities, token, "visibility")

    def _found(self, rows: Mapping[str, T], token: str, table: str) -> T:
        row = rows.get(token)
        if row is None:
            raise LogError(f"{self.folder.table(table)}: no row with token '{token}', which another table names")
        return row


def read_tables(folder: Folder) -> Tables:
    """Read them.

    Raises:
        LogError: where one is wrong.
    """
    return Tables(
        folder,
        by_token(Sensor, folder.table("sensor")),
        by_token(CalibratedSensor, folder.table("calibrated_sensor")),
        {token: row.name for token, row in by_token(Named, folder.table("category")).items()},
        {row.token: row.category_token for row in parsed_rows(Instance, folder.table("instance"))},
        {token: row.name for token, row in by_token(Named, folder.table("attribute")).items()},
        {token: row.level for token, row in by_token(Visibility, folder.table("visibility")).items()},
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
    """Return the scenes by name, sorted.

    Raises:
        LogError: where the table is wrong, is empty, or two scenes have one name.
    """
    path = folder.table("scene")
    scenes: dict[str, Scene] = {}
    for scene in by_token(Scene, path).values():
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
    links: Mapping[str, _Link]
    """By token."""
    nums: Mapping[str, int]
    """How many samples name a scene, by its token."""
    logs: Mapping[str, Log]

    def chain(self, scene: Scene) -> tuple[Instant, ...]:
        """Return the samples of a scene in the order of time.

        Raises:
            LogError: where the chain leaves the scene, loops, runs back in time, or isn't as the scene says.
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
    """Read `sample` and `log`.

    Raises:
        LogError: where a table is wrong.
    """
    path = folder.table("sample")
    links: dict[str, _Link] = {}
    for row in parsed_rows(Sample, path):
        if row.token in links:
            raise LogError(f"{path}: two rows have the token '{row.token}'")
        links[row.token] = _Link(row.scene_token, row.timestamp, row.prev, row.next)
    return Samples(path, links, Counter(link.scene for link in links.values()), by_token(Log, folder.table("log")))
