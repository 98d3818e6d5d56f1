"""Importer of nuScenes: six cameras, a LiDAR, five radars, ego poses and 3D boxes.

H. Caesar et al., "nuScenes: A multimodal dataset for autonomous driving", CVPR 2020. Layout of the tables:
https://github.com/nutonomy/nuscenes-devkit, `docs/schema_nuscenes.md`.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from fbench.datasets.nuscenes.messages import REFERENCE, Content, Findings, Rows, items, summary_lines
from fbench.datasets.nuscenes.opened import NuScenesSet
from fbench.datasets.nuscenes.rows import Scene
from fbench.datasets.nuscenes.sensors import rig_of
from fbench.datasets.nuscenes.tables import TABLES, open_folder, read_scenes
from fbench.datasets.nuscenes.truth import SceneTruth
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import ImportWish, describe_params, file_facts, log_id
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import LogInfo, Rig

TIMEOUT_MS = 100
"""How long frames wait: cameras measure up to 50 ms before the LiDAR's sweep ends, radars up to 80 ms away from it."""


@dataclass(frozen=True)
class NuScenesParams:
    """Parameters of `NuScenes`."""

    version: str = ""
    """Folder with the tables, such as v1.0-mini; needed where there are several."""
    sweeps: bool = True
    """Also import what was measured between keyframes; those messages have no frame number and no truth."""
    radar_filter: bool = True
    """Drop radar echoes as nuscenes-devkit does by default; see `radar.is_kept`."""


class NuScenes:
    """Reads `v1.0-NAME/*.json`, the tables, and the files that they name: `samples/SENSOR/*`, `sweeps/SENSOR/*`.

    The folder may also be the one with the tables, beside `samples/` and `sweeps/`. One scene becomes one log, named
    as the scene is. Messages of keyframes and their truth have the number of their sample within the scene, from 0 on,
    as frame number; `--frames` counts the same. Body coordinates are those of the ego vehicle.
    """

    def __init__(self, params: NuScenesParams = NuScenesParams()) -> None:
        self._params = params

    def names(self, source: Path) -> Sequence[str]:
        """Names of the scenes, sorted; see `Importer`."""
        return tuple(read_scenes(open_folder(source, self._params.version)))

    def recordings(self, source: Path, wish: ImportWish) -> Iterator["NuScenesRecording"]:
        """Open the scenes; the large tables are read once, when the first scene needs them; see `Importer`."""
        with closing(NuScenesSet(open_folder(source, self._params.version), self._params.sweeps, wish)) as opened:
            for name in wish.names:
                yield NuScenesRecording(opened, opened.scene(name), self._params, wish)


class NuScenesRecording:
    """One scene; see `Recording`."""

    def __init__(self, opened: NuScenesSet, scene: Scene, params: NuScenesParams, wish: ImportWish) -> None:
        self._opened, self._scene, self._params, self._wish = opened, scene, params, wish
        self.name = scene.name
        self._findings = Findings()

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the scene, from small tables alone."""
        folder, scene = self._opened.folder, self._scene
        chain = self._opened.excerpt(scene).chain
        facts = [scene.token, *file_facts(folder.root, [folder.table(name) for name in TABLES])]
        drive = self._opened.drive(scene)
        metadata = {
            "dataset": "nuScenes",
            "licence": "CC BY-NC-SA 4.0",
            "reference": REFERENCE,
            "timeout_ms": str(TIMEOUT_MS),
            "stamps": "LiDAR: end of the sweep; cameras: trigger of the exposure; truth: that of LIDAR_TOP",
            "radar.radial_velocity": "(vx, vy) as measured, along the line of sight",
            "truth.visibility": "middle of the set's bin: 0.2, 0.5, 0.7 or 0.9",
            "description": scene.description,
            "location": drive.location,
            "vehicle": drive.vehicle,
            "date": drive.date_captured,
            "nuscenes.version": folder.version,
            "nuscenes.scene": scene.token,
            "nuscenes.log": scene.log_token,
            "nuscenes.logfile": drive.logfile,
            "nuscenes.sample_tokens": " ".join(instant.token for instant in chain),
            **describe_params(self._params),
        }
        return LogInfo(scene.name, log_id("nuscenes", facts, self._wish.frames, self._params), metadata)

    @cached_property
    def rig(self) -> Rig:
        """Sensors that measured something in the chosen part, and their calibration."""
        return rig_of([row for row, _ in self._rows], self._opened.tables, self.name)

    @property
    def num_items(self) -> int:
        """Measurements, as many poses, and truth."""
        return 2 * len(self._rows) + len(self._opened.excerpt(self._scene).samples)

    def items(self) -> Iterator[Message | Truth]:
        """Poses, measurements and truth."""
        excerpt = self._opened.excerpt(self._scene)
        content = Content(
            self._opened.folder, self.rig, excerpt.chain, excerpt.samples, self._rows, self._truth(),
            self._params.radar_filter,
        )  # fmt: skip
        yield from items(content, self._findings, self._wish.bad)

    def summary(self) -> Sequence[str]:
        """What was found."""
        lines = summary_lines(self._findings, self._opened.excerpt(self._scene), self.rig, self._params.radar_filter)
        return [f"scene: {self._scene.description or self._scene.name}", *lines]

    @cached_property
    def _rows(self) -> Rows:
        rows = tuple(self._opened.database.data(self._opened.number(self._scene)))
        if not rows:
            path, chosen = self._opened.folder.table("sample_data"), self._wish.frames
            part = "" if chosen.is_whole else f" in frames {chosen}"
            raise LogError(f"{path}: nothing was measured in {self.name}{part}")
        return rows

    def _truth(self) -> SceneTruth | None:
        opened = self._opened
        rows = opened.database.annotations(opened.number(self._scene))
        chain = opened.excerpt(self._scene).chain
        return SceneTruth(rows, chain, opened.tables, self._wish.bad) if opened.is_labeled else None
