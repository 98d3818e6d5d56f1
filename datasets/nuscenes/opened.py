"""The tables of one import, read in one pass each and shared by its scenes."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from fbench.datasets.nuscenes import rows
from fbench.datasets.nuscenes.tables import AnnotationRow, Database, DataRow, Folder, PoseRow, Tables
from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest
from fbench.replay.logs.containers.limits import crc32

Place = tuple[int, int]  # Number of a scene, and of a sample within it
_SLOTS = 1 << 24


class Instant(NamedTuple):
    """One sample of a scene."""

    token: str
    stamp_us: int


class _Link(NamedTuple):
    scene: str
    stamp_us: int
    prev: str
    next: str


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
        return range(begin_us, self.chain[stop].stamp_us if stop < len(self.chain) else rows.MAX_US + 1)


class _Filling:
    """Takes from `sample_data`, `ego_pose` and `sample_annotation` what the chosen scenes need.

    `places` says where each sample of the set belongs, by token, `None` for those of scenes that aren't chosen;
    `excerpts` what is wanted of each chosen scene, by its number.
    """

    def __init__(
        self, tables: Tables, places: Mapping[str, Place | None], excerpts: Mapping[int, Excerpt], bad: BadInput
    ) -> None:
        self._tables, self._places, self._excerpts, self._bad = tables, places, excerpts, bad
        # A slot for each wanted token: some poses that nobody wants are kept too, but no set of millions of tokens.
        self._wanted = bytearray(_SLOTS)
        self.num_annotations = 0  # Of the whole set; that of the test split has none

    def data(self) -> Iterator[DataRow]:
        for data, (scene, sample) in self._choose(rows.SampleData, "sample_data"):
            if not self._excerpts[scene].holds(sample, data.is_key_frame, data.timestamp):
                continue
            try:
                channel = self._tables.sensor(data.calibrated_sensor_token).channel
            except LogError as error:
                self._bad.report(error)
                continue
            self._wanted[_slot(data.ego_pose_token)] = 1
            yield DataRow(
                scene, data.timestamp, channel, sample, data.is_key_frame, data.calibrated_sensor_token,
                data.filename, data.width, data.height, data.token, data.ego_pose_token,
            )  # fmt: skip

    def poses(self) -> Iterator[PoseRow]:
        path = self._tables.folder.table("ego_pose")
        for row in rows.json_rows(path):
            if self._wanted[_slot(str(row.get("token")))]:
                try:
                    pose = rows.parse_row(rows.EgoPose, row, path)
                except LogError as error:
                    self._bad.report(error)
                    continue
                yield PoseRow(pose.token, pose.timestamp, *pose.translation, *pose.rotation)

    def annotations(self) -> Iterator[AnnotationRow]:
        for box, (scene, sample) in self._choose(rows.Annotation, "sample_annotation"):
            yield AnnotationRow(
                scene, sample, box.token, box.instance_token, " ".join(box.attribute_tokens), box.visibility_token,
                *box.translation, *box.size, *box.rotation, box.num_lidar_pts, box.num_radar_pts, box.prev, box.next,
            )  # fmt: skip

    def _choose(self, model: type[rows.R], table: str) -> Iterator[tuple[rows.R, Place]]:
        """Yield the rows of chosen scenes with their places."""
        path = self._tables.folder.table(table)
        for row in rows.json_rows(path):
            self.num_annotations += table == "sample_annotation"
            token = str(row.get("sample_token"))
            try:
                if token not in self._places:
                    found = f"'{token[:64]}', which isn't in sample.json"
                    raise LogError(f"{path}: row with token '{str(row.get('token'))[:64]}': sample_token {found}")
                if (place := self._places[token]) is None:
                    continue
                parsed = rows.parse_row(model, row, path)
            except LogError as error:
                self._bad.report(error)
                continue
            yield parsed, place


def _slot(token: str) -> int:
    return crc32(token.encode(errors="surrogatepass")) % _SLOTS


class NuScenesSet:
    """The tables of one import, shared by its scenes. Raises LogError where `scene`, `sample` or `log` is wrong."""

    def __init__(self, folder: Folder, sweeps: bool, request: ImportRequest) -> None:
        self.folder, self._sweeps, self._request = folder, sweeps, request
        self._scenes = read_scenes(folder)
        self._links: dict[str, _Link] = {}
        for row in rows.parse_rows(rows.Sample, folder.table("sample")):
            if row.token in self._links:
                raise LogError(f"{folder.table('sample')}: two rows have the token '{row.token}'")
            self._links[row.token] = _Link(row.scene_token, row.timestamp, row.prev, row.next)
        self._num_samples = Counter(link.scene for link in self._links.values())
        self._logs = rows.read_by_token(rows.Log, folder.table("log"))
        self._database: Database | None = None
        self._error: LogError | None = None
        self.is_labeled = False

    def close(self) -> None:
        """Forget the tables."""
        if self._database is not None:
            self._database.close()

    def scene(self, name: str) -> rows.Scene:
        """Return a scene. Raises ConfigError where there is none of this name."""
        if name not in self._scenes:
            raise ConfigError(f"{self.folder.table('scene')}: no scene '{name}'{did_you_mean(name, self._scenes)}")
        return self._scenes[name]

    def drive(self, scene: rows.Scene) -> rows.Log:
        """Return the drive that a scene is of. Raises LogError where it isn't known."""
        if (found := self._logs.get(scene.log_token)) is None:
            path = self.folder.table("log")
            raise LogError(f"{path}: no row with token '{scene.log_token}', which {scene.name} names")
        return found

    def number(self, scene: rows.Scene) -> int:
        """Return what the database calls a scene."""
        return list(self._scenes).index(scene.name)

    def excerpt(self, scene: rows.Scene) -> Excerpt:
        """Return what is wanted. LogError: the chain of samples leaves the scene, loops, runs back or isn't as said."""
        chain: list[Instant] = []
        path, token, prev = self.folder.table("sample"), scene.first_sample_token, ""
        while token:
            link = self._links.get(token)
            if link is None:
                raise LogError(f"{path}: no sample '{token}', which {scene.name} has")
            if link.scene != scene.token:
                raise LogError(f"{path}: sample '{token}' is of another scene than {scene.name}, which links it")
            if link.prev != prev:
                raise LogError(f"{path}: sample '{token}' follows '{link.prev}', but is next of '{prev}'")
            if chain and link.stamp_us <= chain[-1].stamp_us:
                raise LogError(f"{path}: sample '{token}' isn't later than '{prev}', of which it is next")
            chain.append(Instant(token, link.stamp_us))
            token, prev = link.next, token
        num = self._num_samples[scene.token]
        if prev != scene.last_sample_token or not len(chain) == scene.nbr_samples == num:
            there = f"links {len(chain)} of its {num} samples and ends with '{prev}'"
            expected = f"expected {scene.nbr_samples} that end with '{scene.last_sample_token}'"
            raise LogError(f"{path}: {scene.name} {there}, {expected}")
        return Excerpt(tuple(chain), self._request.frames, self._sweeps)

    @cached_property
    def tables(self) -> Tables:
        """The tables that are held."""
        return Tables(self.folder)

    @property
    def database(self) -> Database:
        """The large tables, as far as scenes need them. LogError where one is wrong, again without reading on."""
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
        for scene in map(self.scene, self._request.names):
            with suppress(LogError):  # reported when it is this scene's turn
                excerpts[self.number(scene)] = self.excerpt(scene)
        places: dict[str, Place | None] = dict.fromkeys(self._links)
        for number, excerpt in excerpts.items():
            places.update((instant.token, (number, sample)) for sample, instant in enumerate(excerpt.chain))
        filling, database = _Filling(self.tables, places, excerpts, self._request.bad), Database()
        try:
            database.fill("data", filling.data(), self.folder.table("sample_data"))
            database.fill("pose", filling.poses(), self.folder.table("ego_pose"))
            database.fill("annotation", filling.annotations(), self.folder.table("sample_annotation"))
        except BaseException:
            database.close()
            raise
        self.is_labeled = filling.num_annotations > 0
        return database


def read_scenes(folder: Folder) -> Mapping[str, rows.Scene]:
    """The scenes by name, sorted. Raises LogError where the table is wrong or empty, or two scenes have one name."""
    path = folder.table("scene")
    scenes: dict[str, rows.Scene] = {}
    for scene in rows.read_by_token(rows.Scene, path).values():
        if scene.name in scenes:
            raise LogError(f"{path}: two scenes are called '{scene.name}', only one of them may be there")
        scenes[scene.name] = scene
    if not scenes:
        raise LogError(f"{path}: no scenes")
    return dict(sorted(scenes.items()))
