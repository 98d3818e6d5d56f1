"""Importer of KITTI: raw drives, tracking and object benchmarks.

A. Geiger, P. Lenz, C. Stiller and R. Urtasun, "Vision meets Robotics: The KITTI Dataset", IJRR 2013;
A. Geiger, P. Lenz and R. Urtasun, "Are we ready for Autonomous Driving? The KITTI Vision Benchmark Suite", CVPR 2012.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from fbench.datasets.kitti import raw
from fbench.datasets.kitti.benchmark import BenchmarkRecording
from fbench.datasets.kitti.frames import ObjectFrames, TrackingFrames, has_frames, sequences
from fbench.datasets.kitti.labels import results_folder
from fbench.datasets.kitti.sensors import KittiParams, split_folders
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import ImportRequest, require_folder
from fbench.replay.contracts.protocols import Recording

_DEFAULTS = KittiParams()
_Open = Callable[[ImportRequest, Path | None], TrackingFrames | ObjectFrames]


class Kitti:
    """Reads what KITTI's downloads unpack to, one of these or several in one folder:

    - raw drives: `DATE/DATE_drive_NNNN_sync/`, beside `DATE/calib_*.txt`; each drive is a sequence;
    - the tracking benchmark: `label_02/NNNN.txt`, `calib/NNNN.txt`, and where there are such `image_02/NNNN/`,
      `image_03/NNNN/`, `velodyne/NNNN/` with files `FFFFFF.png` and `FFFFFF.bin`, `oxts/NNNN.txt`,
      `evaluate_tracking.seqmap*`; each NNNN is a sequence;
    - the object benchmark: `calib/FFFFFF.txt`, and where there are such `label_2/FFFFFF.txt`, `image_2/`, `image_3/`,
      `velodyne/`; all frames are one log, named as the folder is.

    The benchmarks' files may be in `training/` and `testing/` of the folder: where both are there, names begin with it.
    """

    def __init__(self, params: KittiParams = _DEFAULTS) -> None:
        self._params = params

    def names(self, source: Path) -> Sequence[str]:
        """See `Importer`."""
        require_folder(source)
        names = [*raw.find_drives(source), *_benchmarks(source)]
        if not names:
            raise LogError(
                f"{source}: no KITTI data; expected raw drives (2011_09_26/2011_09_26_drive_0001_sync/), the tracking "
                "benchmark (label_02/0000.txt or image_02/0000/, with calib/0000.txt) or the object benchmark "
                "(label_2/000000.txt or image_2/000000.png, with calib/000000.txt)"
            )
        return names

    def recordings(self, source: Path, request: ImportRequest) -> Iterator[Recording]:
        """See `Importer`; raises `ConfigError` where the folder of detections can't be one."""
        folder = self._params.detections
        detections = None if folder is None else results_folder(folder)
        benchmarks = _benchmarks(source)
        for name in request.names:
            if name in benchmarks:
                yield BenchmarkRecording(benchmarks[name](request, detections), request)
            else:
                yield raw.recording(name, source, request, self._params)


def _benchmarks(source: Path) -> Mapping[str, _Open]:
    """What opens each of the benchmarks' sequences, by name."""
    found: dict[str, _Open] = {}
    for prefix, folder in split_folders(source).items():
        for sequence in sequences(folder):
            name = f"{prefix}{sequence}"
            found[name] = partial(TrackingFrames, name, folder, sequence)
        if has_frames(folder):
            name = prefix.rstrip("/") or folder.resolve().name
            found[name] = partial(ObjectFrames, name, folder)
    return found
