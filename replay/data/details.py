"""Details of scores, ready to be drawn, as `details.json` holds them: curves, objects, and frames."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from fbench.replay.contracts.errors import RunError, first_wrong
from fbench.replay.data.files import replace_text

FILE = "details.json"


@dataclass(frozen=True)
class ScoreCurve:
    """Detections of one class at thresholds of their score, the highest threshold first."""

    class_: str
    matching: str
    threshold: tuple[float, ...]
    precision: tuple[float, ...]
    recall: tuple[float, ...]
    f1: tuple[float, ...]


@dataclass(frozen=True)
class Span:
    """Frames in a row in which a truth object has the same track."""

    first_frame: int
    last_frame: int
    track_id: int | None  # `None`: no track is on it


@dataclass(frozen=True)
class ObjectTrack:
    """What became of one truth object over time."""

    label: str
    track_id: int
    camera: str  # In whose image it is followed; empty in 3D
    num_frames: int  # In which it had to be found
    num_missed: int
    num_switches: int
    num_fragments: int  # How often it was lost, and found again
    range_m: float | None  # Least distance from the body, in the ground plane
    spans: tuple[Span, ...]


@dataclass(frozen=True)
class FrameErrors:
    """Detections of all vehicles, frame by frame; in images, of all cameras."""

    frame: tuple[int, ...]
    tp: tuple[int, ...]
    fp: tuple[int, ...]
    fn: tuple[int, ...]


@dataclass(frozen=True)
class Details:
    """All of it; in the order of the run's scores."""

    curves: tuple[ScoreCurve, ...] = ()
    objects: tuple[ObjectTrack, ...] = ()
    frames: FrameErrors = FrameErrors((), (), (), ())


def save_details(folder: Path, details: Details) -> None:
    """Write details into a run folder; equal details give equal bytes."""
    replace_text(folder / FILE, json.dumps(asdict(details), allow_nan=False, separators=(",", ":")) + "\n")


def load_details(folder: Path) -> Details | None:
    """Read what `save_details` wrote; `None` where a run has none, as those of older versions. Raises RunError where
    the file isn't as expected.
    """
    from pydantic import TypeAdapter, ValidationError

    path = folder / FILE
    try:
        return TypeAdapter(Details).validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        why = first_wrong(error) if isinstance(error, ValidationError) else error.strerror
        raise RunError(f"{path}: no details of scores ({why}); score the run again") from error
