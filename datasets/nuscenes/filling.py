"""One pass over each large table for all scenes of an import."""

from collections.abc import Iterator, Mapping
from typing import Any

from fbench.datasets.nuscenes.database import AnnotationRow, Database, DataRow, PoseRow
from fbench.datasets.nuscenes.excerpt import Excerpt
from fbench.datasets.nuscenes.json_rows import json_rows
from fbench.datasets.nuscenes.rows import Annotation, EgoPose, SampleData, parsed
from fbench.datasets.nuscenes.tables import Tables
from fbench.replay.checksums import crc32
from fbench.replay.errors import LogError
from fbench.replay.imports.wish import BadInput

Place = tuple[int, int]
"""Number of a scene, and of a sample within it."""
_SLOTS = 1 << 24


class Filling:
    """Takes from `sample_data`, `ego_pose` and `sample_annotation` what the chosen scenes need."""

    def __init__(
        self, tables: Tables, places: Mapping[str, Place | None], excerpts: Mapping[int, Excerpt], bad: BadInput
    ) -> None:
        """Begin.

        Args:
            tables: The other tables.
            places: Where each sample of the set belongs, by token; `None` for those of scenes that aren't chosen.
            excerpts: What is wanted of each chosen scene, by its number.
            bad: Takes rows that can't be used.
        """
        self._tables, self._places, self._excerpts, self._bad = tables, places, excerpts, bad
        # A slot for each wanted token: some poses that nobody wants are kept too, but no set of millions of tokens.
        self._wanted = bytearray(_SLOTS)
        self.num_annotations = 0
        """Of the whole set; that of the test split has none."""

    def fill(self, database: Database) -> None:
        """Read the tables.

        Raises:
            LogError: where one can't be used.
        """
        path = self._tables.folder.table
        database.fill("data", self._data(), path("sample_data"))
        database.fill("pose", self._poses(), path("ego_pose"))
        database.fill("annotation", self._annotations(), path("sample_annotation"))

    def _data(self) -> Iterator[DataRow]:
        for row, place in self._placed("sample_data"):
            try:
                found = self._data_row(row, *place)
            except LogError as error:
                self._bad.met(error)
                continue
            if found is not None:
                self._wanted[_slot(found.pose)] = 1
                yield found

    def _data_row(self, row: Mapping[str, Any], scene: int, sample: int) -> DataRow | None:
        data = parsed(SampleData, row, self._tables.folder.table("sample_data"))
        if not self._excerpts[scene].holds(sample, data.is_key_frame, data.timestamp):
            return None
        sensor = self._tables.sensor(self._tables.calibration(data.calibrated_sensor_token))
        return DataRow(
            scene, data.timestamp, sensor.channel, sample, data.is_key_frame, data.calibrated_sensor_token,
            data.filename, data.width, data.height, data.token, data.ego_pose_token,
        )  # fmt: skip

    def _poses(self) -> Iterator[PoseRow]:
        path = self._tables.folder.table("ego_pose")
        for row in json_rows(path):
            if not self._wanted[_slot(str(row.get("token")))]:
                continue
            try:
                pose = parsed(EgoPose, row, path)
            except LogError as error:
                self._bad.met(error)
                continue
            yield PoseRow(pose.token, pose.timestamp, *pose.translation, *pose.rotation)

    def _annotations(self) -> Iterator[AnnotationRow]:
        path = self._tables.folder.table("sample_annotation")
        for row, (scene, sample) in self._placed("sample_annotation"):
            try:
                box = parsed(Annotation, row, path)
            except LogError as error:
                self._bad.met(error)
                continue
            yield AnnotationRow(
                scene, sample, box.token, box.instance_token, " ".join(box.attribute_tokens), box.visibility_token,
                *box.translation, *box.size, *box.rotation, box.num_lidar_pts, box.num_radar_pts, box.prev, box.next,
            )  # fmt: skip

    def _placed(self, table: str) -> Iterator[tuple[Mapping[str, Any], Place]]:
        """Yield the rows of chosen scenes with their places."""
        path = self._tables.folder.table(table)
        for row in json_rows(path):
            self.num_annotations += table == "sample_annotation"
            token = str(row.get("sample_token"))
            if token not in self._places:
                found = f"'{token[:64]}', which isn't in sample.json"
                self._bad.met(LogError(f"{path}: row with token '{str(row.get('token'))[:64]}': sample_token {found}"))
            elif (place := self._places[token]) is not None:
                yield row, place


def _slot(token: str) -> int:
    return crc32(token.encode(errors="surrogatepass")) % _SLOTS
