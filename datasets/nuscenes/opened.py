"""The tables of one import, read in one pass each and shared by its scenes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from fbench.datasets.nuscenes.rows import MAX_US, Annotation, EgoPose, Log, SampleData, Scene, json_rows, parse_row
from fbench.datasets.nuscenes.tables import (
    AnnotationRow,
    Database,
    DataRow,
    Folder,
    Instant,
    PoseRow,
    Samples,
    Tables,
    read_samples,
    read_scenes,
    read_tables,
)
from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportWish
from fbench.replay.logs.containers.limits import crc32


@dataclass(frozen=True)
class Excerpt:
    """Which samples of a scene are wanted, and what was measured between them."""

    chain: Sequence[Instant]  # All samples of the scene
    frames: FrameRange  # By number within the scene
    sweeps: bool  # Whether what lies between the samples is wanted

    @cached_property
    def samples(self) -> range:
        """Numbers of the samples."""
        num, stop = len(self.chain), self.frames.stop
        return range(min(self.frames.first, num), num if stop is None else min(stop, num))

    def holds(self, sample: int, is_key: bool, stamp_us: int) -> bool:
        """Tell whether a measurement is wanted: of keyframes by their sample, of sweeps by time.

        Sweeps are wanted from the first sample's stamp on until before that of the first sample behind the range;
        those before the scene's first sample come with it, those after its last one with that. So ranges that follow
        each other share nothing and lack nothing.
        """
        if is_key:
            return sample in self.samples
        return self.sweeps and len(self.samples) > 0 and stamp_us in self._stamps_us

    @cached_property
    def _stamps_us(self) -> range:
        first, stop = self.samples.start, self.samples.stop
        begin_us = self.chain[first].stamp_us if first else 0
        return range(begin_us, self.chain[stop].stamp_us if stop < len(self.chain) else MAX_US + 1)


Place = tuple[int, int]  # Number of a scene, and of a sample within it
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
        """Read the tables. Raises LogError where one can't be used."""
        path = self._tables.folder.table
        database.fill("data", self._data(), path("sample_data"))
        database.fill("pose", self._poses(), path("ego_pose"))
        database.fill("annotation", self._annotations(), path("sample_annotation"))

    def _data(self) -> Iterator[DataRow]:
        path = self._tables.folder.table("sample_data")
        for row, (scene, sample) in self._choose("sample_data"):
            try:
                data = parse_row(SampleData, row, path)
                if not self._excerpts[scene].holds(sample, data.is_key_frame, data.timestamp):
                    continue
                sensor = self._tables.sensor(self._tables.calibration(data.calibrated_sensor_token))
            except LogError as error:
                self._bad.report(error)
                continue
            self._wanted[_slot(data.ego_pose_token)] = 1
            yield DataRow(
                scene, data.timestamp, sensor.channel, sample, data.is_key_frame, data.calibrated_sensor_token,
                data.filename, data.width, data.height, data.token, data.ego_pose_token,
            )  # fmt: skip

    def _poses(self) -> Iterator[PoseRow]:
        path = self._tables.folder.table("ego_pose")
        for row in json_rows(path):
            if not self._wanted[_slot(str(row.get("token")))]:
                continue
            try:
                pose = parse_row(EgoPose, row, path)
            except LogError as error:
                self._bad.report(error)
                continue
            yield PoseRow(pose.token, pose.timestamp, *pose.translation, *pose.rotation)

    def _annotations(self) -> Iterator[AnnotationRow]:
        path = self._tables.folder.table("sample_annotation")
        for row, (scene, sample) in self._choose("sample_annotation"):
            try:
                box = parse_row(Annotation, row, path)
            except LogError as error:
                self._bad.report(error)
                continue
            yield AnnotationRow(
                scene, sample, box.token, box.instance_token, " ".join(box.attribute_tokens), box.visibility_token,
                *box.translation, *box.size, *box.rotation, box.num_lidar_pts, box.num_radar_pts, box.prev, box.next,
            )  # fmt: skip

    def _choose(self, table: str) -> Iterator[tuple[Mapping[str, Any], Place]]:
        """Yield the rows of chosen scenes with their places."""
        path = self._tables.folder.table(table)
        for row in json_rows(path):
            self.num_annotations += table == "sample_annotation"
            token = str(row.get("sample_token"))
            if token not in self._places:
                found = f"'{token[:64]}', which isn't in sample.json"
                self._bad.report(
                    LogError(f"{path}: row with token '{str(row.get('token'))[:64]}': sample_token {found}")
                )
            elif (place := self._places[token]) is not None:
                yield row, place


def _slot(token: str) -> int:
    return crc32(token.encode(errors="surrogatepass")) % _SLOTS


class NuScenesSet:
    """The tables of one import, shared by its scenes."""

    def __init__(self, folder: Folder, sweeps: bool, wish: ImportWish) -> None:
        """Begin. Raises LogError where `scene`, `sample` or `log` is wrong."""
        self.folder, self._sweeps, self._wish = folder, sweeps, wish
        self._scenes = read_scenes(folder)
        self.samples: Samples = read_samples(folder)
        self._database: Database | None = None
        self._error: LogError | None = None
        self.is_labeled = False

    def close(self) -> None:
        """Forget the tables."""
        if self._database is not None:
            self._database.close()

    def scene(self, name: str) -> Scene:
        """Return a scene. Raises ConfigError where there is none of this name."""
        if name not in self._scenes:
            raise ConfigError(f"{self.folder.table('scene')}: no scene '{name}'{did_you_mean(name, self._scenes)}")
        return self._scenes[name]

    def drive(self, scene: Scene) -> Log:
        """Return the drive that a scene is of. Raises LogError where it isn't known."""
        found = self.samples.logs.get(scene.log_token)
        if found is None:
            raise LogError(
                f"{self.folder.table('log')}: no row with token '{scene.log_token}', which {scene.name} names"
            )
        return found

    def number(self, scene: Scene) -> int:
        """Return what the database calls a scene."""
        return list(self._scenes).index(scene.name)

    def excerpt(self, scene: Scene) -> Excerpt:
        """Return what is wanted of a scene. Raises LogError where its samples don't form a chain."""
        return Excerpt(self.samples.chain(scene), self._wish.frames, self._sweeps)

    @cached_property
    def tables(self) -> Tables:
        """The tables that are held."""
        return read_tables(self.folder)

    @property
    def database(self) -> Database:
        """The large tables, as far as the chosen scenes need them. Raises LogError where one is wrong; the same each
        time, since nobody wants to read on for that.
        """
        if self._error is not None:
            raise self._error
        if self._database is None:
            try:
                self._database = self._fill()
            except LogError as error:
                self._error = error
                raise
        return self._database

    def _fill(self) -> Database:
        excerpts: dict[int, Excerpt] = {}
        for scene in map(self.scene, self._wish.names):
            try:
                excerpts[self.number(scene)] = self.excerpt(scene)
            except LogError:
                continue  # reported when it is this scene's turn
        places: dict[str, Place | None] = dict.fromkeys(self.samples.links)
        for number, excerpt in excerpts.items():
            places.update((instant.token, (number, sample)) for sample, instant in enumerate(excerpt.chain))
        filling = Filling(self.tables, places, excerpts, self._wish.bad)
        database = Database()
        try:
            filling.fill(database)
        except BaseException:
            database.close()
            raise
        self.is_labeled = filling.num_annotations > 0
        return database
