"""The tables of one import, shared by its scenes."""

from functools import cached_property

from fbench.datasets.nuscenes.database import Database
from fbench.datasets.nuscenes.excerpt import Excerpt
from fbench.datasets.nuscenes.filling import Filling, Place
from fbench.datasets.nuscenes.folder import Folder
from fbench.datasets.nuscenes.rows import Log, Scene
from fbench.datasets.nuscenes.scenes import Samples, read_samples, read_scenes
from fbench.datasets.nuscenes.tables import Tables, read_tables
from fbench.replay.errors import ConfigError, LogError
from fbench.replay.imports.wish import ImportWish
from fbench.replay.names import did_you_mean


class NuScenesSet:
    """The tables of one import, shared by its scenes."""

    def __init__(self, folder: Folder, sweeps: bool, wish: ImportWish) -> None:
        """Begin.

        Raises:
            LogError: where `scene`, `sample` or `log` is wrong.
        """
        self.folder, self._sweeps, self._wish = folder, sweeps, wish
        self._scenes = read_scenes(folder)
        self.samples: Samples = read_samples(folder)
        self._database: Database | None = None
        self._error: LogError | None = None
        self.is_labelled = False

    def close(self) -> None:
        """Forget the tables."""
        if self._database is not None:
            self._database.close()

    def scene(self, name: str) -> Scene:
        """Return a scene.

        Raises:
            ConfigError: where there is none of this name.
        """
        if name not in self._scenes:
            raise ConfigError(f"{self.folder.table('scene')}: no scene '{name}'{did_you_mean(name, self._scenes)}")
        return self._scenes[name]

    def drive(self, scene: Scene) -> Log:
        """Return the drive that a scene is of.

        Raises:
            LogError: where it isn't known.
        """
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
        """Return what is wanted of a scene.

        Raises:
            LogError: where its samples don't form a chain.
        """
        return Excerpt(self.samples.chain(scene), self._wish.frames, self._sweeps)

    @cached_property
    def tables(self) -> Tables:
        """The tables that are held."""
        return read_tables(self.folder)

    @property
    def database(self) -> Database:
        """The large tables, as far as the chosen scenes need them.

        Raises:
            LogError: where one is wrong; the same each time, since nobody wants to read on for that.
        """
        if self._error is not None:
            raise self._error
        if self._database is None:
            try:
                self._database = self._filled()
            except LogError as error:
                self._error = error
                raise
        return self._database

    def _filled(self) -> Database:
        excerpts = self._excerpts()
        places: dict[str, Place | None] = dict.fromkeys(self.samples.links)
        for scene, excerpt in excerpts.items():
            places.update((instant.token, (scene, sample)) for sample, instant in enumerate(excerpt.chain))
        filling = Filling(self.tables, places, excerpts, self._wish.bad)
        database = Database()
        try:
            filling.fill(database)
        except BaseException:
            database.close()
            raise
        self.is_labelled = filling.num_annotations > 0
        return database

    def _excerpts(self) -> dict[int, Excerpt]:
        """Of the scenes that can be used; the others are told of when it is their turn."""
        excerpts = {}
        for name in self._wish.names:
            scene = self.scene(name)
            try:
                excerpts[self.number(scene)] = self.excerpt(scene)
            except LogError:
                continue
        return excerpts
