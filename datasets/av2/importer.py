"""Importer of Argoverse 2's sensor dataset: nine cameras, LiDAR sweeps, poses, 3D boxes and drivable areas.

B. Wilson et al., "Argoverse 2: Next Generation Datasets for Self-Driving Perception and Forecasting", NeurIPS 2021,
https://arxiv.org/abs/2301.00493; files: https://argoverse.github.io/user-guide/datasets/sensor.html.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from pydantic import BaseModel, FiniteFloat

from fbench.datasets.av2.tables import (
    CALIBRATION,
    LABELS,
    LENSES,
    LIDAR,
    MOUNTS,
    Annotations,
    read_poses,
    read_rig,
    read_sweep,
)
from fbench.datasets.importing.files import entries, find_numbered, format_counts, read_image, read_json
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import ImportRequest, describe_params, file_facts, log_id, require_folder
from fbench.replay.data.messages import Message, Pose, Truth
from fbench.replay.data.metadata import REFERENCE, REGIONS, TIMEOUT_MS, Region, regions_text
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.data.scores import format_count
from fbench.replay.formats.text import digest_of

POSES, ANNOTATIONS, EGO = "city_SE3_egovehicle.feather", "annotations.feather", "ego"
_DIGITS = 18  # Of stamps [ns] in names of files
_TIMEOUT_MS = 100  # Images of one turn of the LiDAR are up to 100 ms apart


class _Point(BaseModel):
    x: FiniteFloat
    y: FiniteFloat


class _Area(BaseModel):
    area_boundary: list[_Point]


class _Map(BaseModel):
    """What is read of a log's map."""

    drivable_areas: dict[str, _Area]


@dataclass(frozen=True)
class Av2Params:
    """Parameters of `Av2`."""

    map: bool = True
    """Import the map's drivable areas as regions `road`, for `--region road`."""


class Av2:
    """Reads logs of the sensor dataset: folders with `city_SE3_egovehicle.feather`, and where there are such
    `annotations.feather`, `calibration/*.feather`, `sensors/lidar/STAMP.feather`, `sensors/cameras/NAME/STAMP.jpg`,
    `map/log_map_archive_*.json`.

    The source is a log, a folder with logs, or one with `train/`, `val/` or `test/` in it. A frame is a sweep of the
    LiDAR, or without sweeps an annotated instant; frames are numbered from 0. Body coordinates are the ego vehicle's.
    """

    def __init__(self, params: Av2Params = Av2Params()) -> None:
        self._params = params

    def names(self, source: Path) -> Sequence[str]:
        """Names of the logs, sorted; see `Importer`."""
        return tuple(_find_logs(source))

    def recordings(self, source: Path, request: ImportRequest) -> Iterator["Av2Recording"]:
        """Open the logs; see `Importer`."""
        logs = _find_logs(source)
        for name in request.names:
            yield Av2Recording(name, logs[name], request, self._params)


def _find_logs(source: Path) -> Mapping[str, Path]:
    require_folder(source)
    if (source / POSES).is_file():
        return {source.resolve().name: source}
    found = {path.name: path for path in entries(source) if (path / POSES).is_file()}
    for split in ("train", "val", "test"):
        found |= {f"{split}/{path.name}": path for path in entries(source / split) if (path / POSES).is_file()}
    if not found:
        raise LogError(f"{source}: no log of Argoverse 2: no {POSES} in it, nor in any folder in it")
    return found


class Av2Recording:
    """One log; see `Recording`."""

    def __init__(self, name: str, folder: Path, request: ImportRequest, params: Av2Params) -> None:
        self.name, self._folder, self._request, self._params = name, folder, request, params
        self._num_items: Counter[str] = Counter()
        self._categories: Counter[str] = Counter()

    @cached_property
    def _cameras(self) -> Mapping[str, Mapping[int, Path]]:
        """Images by camera and stamp."""
        folders = [path for path in entries(self._folder / "sensors" / "cameras") if path.is_dir()]
        found = {path.name: find_numbered(path, (".jpg", ".jpeg"), _DIGITS) for path in folders}
        return {name: paths for name, paths in found.items() if paths}

    @cached_property
    def _sweeps(self) -> Mapping[int, Path]:
        return find_numbered(self._folder / "sensors" / "lidar", (".feather",), _DIGITS)

    @cached_property
    def _annotations(self) -> Annotations | None:
        path = self._folder / ANNOTATIONS
        return Annotations(path) if path.exists() else None

    @cached_property
    def _instants(self) -> Sequence[int]:
        """Stamps of all frames."""
        if self._sweeps:
            return tuple(self._sweeps)
        if self._annotations is not None and len(self._annotations.stamp_ns):
            return tuple(np.unique(self._annotations.stamp_ns).tolist())
        if self._cameras:
            return tuple(self._cameras[self._reference])
        raise LogError(f"{self._folder}: neither sweeps in sensors/lidar/ nor images nor {ANNOTATIONS}")

    @cached_property
    def _reference(self) -> str:
        """Whose stamps are the instants of frames; empty: annotations alone."""
        if self._sweeps:
            return LIDAR
        return max(sorted(self._cameras), key=lambda name: len(self._cameras[name])) if self._cameras else ""

    @cached_property
    def _chosen(self) -> tuple[Sequence[tuple[int, int]], range]:
        """Number and stamp of the chosen frames, and the stamps that are near enough to be of them."""
        frames = self._request.frames
        chosen = [(i, stamp) for i, stamp in enumerate(self._instants) if i in frames]
        if not chosen:
            raise LogError(f"{self._folder}: no frame {frames}, there are 0 to {len(self._instants) - 1}")
        margin = _TIMEOUT_MS * 1_000_000
        if frames.is_whole:
            return chosen, range(2**63 - 1)
        return chosen, range(max(chosen[0][1] - margin, 0), chosen[-1][1] + margin)

    @cached_property
    def rig(self) -> Rig:
        """Sensors that have files. Raises LogError naming the calibration that is missing or wrong."""
        return read_rig(self._folder / CALIBRATION, tuple(sorted(self._cameras)), bool(self._sweeps))

    @cached_property
    def _map(self) -> Path | None:
        """The map, where there is one and it is asked for."""
        paths = [path for path in entries(self._folder / "map") if path.name.startswith("log_map_archive_")]
        return paths[0] if self._params.map and paths else None

    @cached_property
    def _areas(self) -> Sequence[Region]:
        if self._map is None:
            return ()
        areas = read_json(self._map, _Map).drivable_areas
        regions = []
        for name in sorted(areas):
            points = np.array([(p.x, p.y) for p in areas[name].area_boundary]).reshape(-1, 2)
            if len(points) < 3:
                raise LogError(
                    f"{self._map}: drivable area {name} has {format_count(len(points), 'corner')}, expected 3 or more"
                )
            x, y = points.T
            area = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
            regions.append(Region("road", points if area > 0 else points[::-1]))
        return regions

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the log."""
        files = [self._folder / POSES, self._folder / ANNOTATIONS, *self._sweeps.values()]
        files += [path for paths in self._cameras.values() for path in paths.values()]
        metadata = {
            "dataset": "Argoverse 2 Sensor",
            "licence": "CC BY-NC-SA 4.0",
            "stamps": "LiDAR: start of the sweep; cameras: exposure; truth: that of the sweep",
            f"lidar.{LIDAR}.motion": "frozen at the stamp",  # sweeps are compensated for the ego's motion
            "av2.log": self._folder.resolve().name,
            **({REFERENCE: self._reference, TIMEOUT_MS: str(_TIMEOUT_MS)} if self._reference else {}),
            **({REGIONS: regions_text(self._areas)} if self._areas else {}),
            **describe_params(self._params),
        }
        # Of small files the content: their size may stay where numbers in them change.
        small = [self._folder / CALIBRATION / name for name in (MOUNTS, LENSES)]
        small += [] if self._map is None else [self._map]
        contents = (f"{path.name} {digest_of(path) if path.is_file() else 'missing'}" for path in small)
        facts = [*file_facts(self._folder, files), *contents]
        return LogInfo(self.name, log_id("av2", facts, self._request.frames, self._params), metadata)

    @property
    def num_items(self) -> int:
        """An estimate: a message for each image and sweep, and truth for each frame; poses aren't counted."""
        return sum(map(len, self._cameras.values())) + 2 * len(self._instants)

    def items(self) -> Iterator[Message | Truth]:
        """Poses, measurements and truth by stamp, at equal stamps in this order."""
        chosen, near = self._chosen
        stamps, places, turns = read_poses(self._folder / POSES)
        rig, number_of = self.rig, {stamp: number for number, stamp in chosen}
        events = [(stamp, 0, EGO, row) for row, stamp in enumerate(stamps.tolist()) if stamp in near]
        events += [(stamp, 1, LIDAR, number) for number, stamp in chosen if stamp in self._sweeps]
        for name, paths in self._cameras.items():
            events += [(stamp, 1, name, -1) for stamp in paths if stamp in near]
        events += [(stamp, 2, "", number) for number, stamp in chosen if self._annotations is not None]
        for stamp_ns, rank, name, row in sorted(events):
            if rank == 0:
                item: Message | Truth = Pose(EGO, stamp_ns, stamp_ns, places[row], turns[row], number_of.get(stamp_ns))
            else:
                try:
                    item = self._measurement(stamp_ns, name, row, rig)
                except LogError as error:
                    self._request.bad.report(error)
                    continue
            self._num_items[name] += 1
            yield item

    def _measurement(self, stamp_ns: int, name: str, number: int, rig: Rig) -> Message | Truth:
        if name == LIDAR:
            return read_sweep(self._sweeps[stamp_ns], stamp_ns, rig.mounts[LIDAR].translation_m, number)
        if name:
            return read_image(self._cameras[name][stamp_ns], name, stamp_ns, rig.cameras[name].size_wh)
        if self._annotations is None:
            raise LogError(f"{self._folder / ANNOTATIONS}: no such file")
        boxes = self._annotations.boxes(stamp_ns)
        self._categories.update([] if boxes.source_label is None else boxes.source_label.tolist())
        return Truth(stamp_ns, stamp_ns, boxes, frame_number=number)

    def summary(self) -> Sequence[str]:
        """What was found and what was odd."""
        chosen = self._chosen[0]
        seconds = (chosen[-1][1] - chosen[0][1]) / 1e9
        kind = "sweeps" if self._sweeps else "annotated instants" if self._annotations is not None else "images"
        lines = [f"frames: {len(chosen)} of {len(self._instants)} {kind}, {seconds:.1f} s"]
        cameras = ", ".join(f"{name} {self._num_items[name]}" for name in sorted(self._cameras))
        lines.append(f"cameras: {cameras or 'none'}")
        lines.append(f"poses: {self._num_items[EGO]}")
        if self._areas:
            lines.append(f"map: {format_count(len(self._areas), 'drivable area')}, as regions 'road'")
        if self._annotations is None:
            return [*lines, "boxes: none, the log isn't labeled"]
        counts = format_counts(self._categories)
        tracks = f", {self._annotations.num_tracks} tracks in the log, without velocities"
        lines.append(f"boxes: {self._categories.total()}{f' ({counts})' if counts else ''}{tracks}")
        if lost := len(set(self._annotations.stamp_ns.tolist()) - set(self._instants)):
            lines.append(f"left out, annotated instants without a sweep: {lost}")
        if unknown := sorted(self._categories.keys() - LABELS.keys()):
            lines.append(f"categories that Argoverse 2 lacks, taken as 'other': {', '.join(unknown)}")
        return lines
