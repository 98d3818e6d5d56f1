"""The tables that an import holds in memory."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

from fbench.datasets.nuscenes.folder import Folder
from fbench.datasets.nuscenes.rows import (
    CalibratedSensor,
    Instance,
    Named,
    Sensor,
    Visibility,
    by_token,
    parsed_rows,
)
from fbench.replay.errors import LogError

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
