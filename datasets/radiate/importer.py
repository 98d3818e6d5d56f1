"""Importer of RADIATE: a spinning Navtech radar, an HDL-32E LiDAR, a ZED stereo camera, GPS/IMU, labels with ids.

M. Sheeny, E. De Pellegrin, S. Mukherjee, A. Ahrabian, S. Wang and A. Wallace, "RADIATE: A Radar Dataset for Automotive
Perception in Bad Weather", ICRA 2021.
"""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path

import numpy as np

from fbench.datasets.radiate.calibration import LIDAR, Calibration, read_calibration, rig_of
from fbench.datasets.radiate.files import (
    ANNOTATIONS,
    GPS,
    META,
    Due,
    SequenceFiles,
    calibration_path,
    dues,
    scan,
    sequences,
)  # fmt: skip
from fbench.datasets.radiate.findings import Findings
from fbench.datasets.radiate.gps import Poses, read_fix
from fbench.datasets.radiate.labels import Annotations, inside_bev, read_annotations
from fbench.datasets.radiate.lidar import read_sweep
from fbench.datasets.radiate.params import DEFAULTS, RadiateParams
from fbench.datasets.radiate.radar import SENSOR as RADAR
from fbench.datasets.radiate.radar import read_polar, scan_of
from fbench.replay.data import LogInfo, Message, RadarScan, Rig, Truth
from fbench.replay.errors import LogError
from fbench.replay.imports.files import read_bytes, read_image
from fbench.replay.imports.identity import described, file_facts, log_id
from fbench.replay.imports.wish import ImportWish

_META_KEYS = {"name": "sequence", "type": "weather", "set": "set", "version": "version"}


class Radiate:
    """Reads a sequence's folder, or all sequences in a folder; their names are those of their folders.

    A sequence has `Navtech_Polar/NNNNNN.png` and `Navtech_Polar.txt` with the stamps, and may have `velo_lidar/*.csv`,
    `zed_left/*.png`, `zed_right/*.png` and `GPS_IMU_Twist/*.txt`, each with a table of stamps, and
    `annotations/annotations.json` and `meta.json`. The SDK's `default-calib.yaml` must lie in it or beside it, or be
    named. `--frames` chooses radar frames by the numbers of their files; other sensors are cut to the time of these,
    and half a radar period more on either side.
    """

    def __init__(self, params: RadiateParams = DEFAULTS) -> None:
        self._params = params

    def names(self, source: Path) -> Sequence[str]:
        """Names of the folders; see `Importer`."""
        return [path.resolve().name for path in sequences(source)]

    def recordings(self, source: Path, wish: ImportWish) -> Iterator["RadiateRecording"]:
        """Open the sequences; see `Importer`."""
        roots = {path.resolve().name: path for path in sequences(source)}
        for name in wish.names:
            yield RadiateRecording(name, roots[name], wish, self._params)


class RadiateRecording:
    """One sequence; see `Recording`.

    Stamps are times of arrival (README of the SDK), and stay as they were recorded. A scan arrives when the radar has
    turned once, clockwise from ahead: what is right of ahead was measured a quarter of a second before what is left of
    it, and LiDAR and camera show it with stamps some 0.3 s earlier. Body coordinates are those of the radar.
    """

    def __init__(self, name: str, root: Path, wish: ImportWish, params: RadiateParams) -> None:
        self.name, self._root, self._wish, self._params = name, root, wish, params
        self._findings = Findings()

    @cached_property
    def _files(self) -> SequenceFiles:
        return scan(self._root, self._wish.bad)

    @cached_property
    def _calibration(self) -> Calibration:
        return read_calibration(calibration_path(self._root, self._params.calibration))

    @cached_property
    def _annotations(self) -> Annotations | None:
        path = self._root / ANNOTATIONS
        try:
            return read_annotations(path, self._wish.bad) if os.path.lexists(path) else None
        except LogError as error:
            self._wish.bad.met(error)
            return None

    @cached_property
    def _dues(self) -> Sequence[Due]:
        offset_ns = int((Decimal(str(self._params.gps_offset_s)) * 1_000_000_000).to_integral_value())
        return dues(self._files, self._wish.frames, offset_ns)

    @cached_property
    def rig(self) -> Rig:
        """Sensors and calibration."""
        return rig_of(self._calibration, self._files.sensors, self._params.right_camera)

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the set and of the sequence."""
        metadata = {
            "dataset": "RADIATE",
            "licence": "CC BY-NC-SA 4.0",
            **_meta(self._root / META),
            "reference": RADAR,
            "stamps": "when each message arrived at the recorder, for each sensor its own",
            "radar.rcs_dbsm": "uncalibrated power: grey value of the polar image",
            "truth.height": "assumed: that of the class; labels are from above",
            **described(self._params),
        }
        return LogInfo(self.name, log_id("radiate", self._facts(), self._wish.frames, self._params), metadata)

    def _facts(self) -> Iterator[str]:
        yield self._calibration.model_dump_json()
        for due in self._dues:
            yield f"{due.sensor} {due.number} {due.stamp_ns}"
        paths = [self._root / ANNOTATIONS, self._root / META, *(self._files.path(due) for due in self._dues)]
        yield from file_facts(self._root, paths)

    @property
    def num_items(self) -> int:
        """A message a file, and the labels of radar frames."""
        return len(self._dues) + sum(due.sensor == RADAR for due in self._dues)

    def items(self) -> Iterator[Message | Truth]:
        """All messages by time, and after each radar scan what was labelled then."""
        poses = Poses(self._params)
        for due in self._dues:
            message = self._message(due, poses)
            if message is not None:
                self._findings.add(message)
                yield message
            if due.sensor == RADAR:
                scan = message if isinstance(message, RadarScan) else None
                truth = self._truth(due, scan)
                if truth is not None:
                    yield truth

    def _message(self, due: Due, poses: Poses) -> Message | None:
        path = self._files.path(due)
        try:
            if due.sensor == RADAR:
                return scan_of(read_polar(path), due.stamp_ns, self._params.cfar)
            if due.sensor == LIDAR:
                return read_sweep(path, due.stamp_ns)
            if due.sensor == GPS:
                return poses.pose(read_fix(path), due.stamp_ns)
            return read_image(path, due.sensor, due.stamp_ns, self.rig.cameras[due.sensor].size_wh)
        except LogError as error:
            self._wish.bad.met(error)
            return None

    def _truth(self, due: Due, scan: RadarScan | None) -> Truth | None:
        boxes = self._annotations.boxes(due.number, self._params.radar_height_m) if self._annotations else None
        if boxes is None:
            self._findings.unlabelled += 1
            return None
        if scan is not None:
            boxes = replace(boxes, num_radar_pts=inside_bev(boxes, scan.xyz).sum(axis=1, dtype=np.int64))
        self._findings.add_boxes(boxes)
        return Truth(due.stamp_ns, due.stamp_ns, boxes)

    def summary(self) -> Sequence[str]:
        """What was found."""
        num_slots = None if self._annotations is None else self._annotations.num_slots
        return list(self._findings.lines(self._files, self._dues, num_slots, self._params))


def _meta(path: Path) -> dict[str, str]:
    """What a sequence says about itself; nothing where it doesn't.

    Raises:
        LogError: where the file isn't an object of JSON.
    """
    if not path.exists():
        return {}
    try:
        content = json.loads(read_bytes(path, 1_000_000))
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path}: isn't JSON ({str(error)[:100]})") from error
    if not isinstance(content, dict):
        raise LogError(f"{path}: expected an object with name, type, set and version")
    # As `errors` shows texts of others: half a surrogate pair can't be stored.
    told = {ours: str(content[key])[:200] for key, ours in _META_KEYS.items() if key in content}
    return {ours: "".join(c if c.isprintable() else " " for c in text) for ours, text in told.items()}
