"""Critical errors of a run, as `criticality.json` holds them, ready to be shown."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from fbench.replay.contracts.errors import RunError, first_wrong
from fbench.replay.data.files import replace_text

FILE = "criticality.json"
Side: TypeAlias = Literal["detections", "tracks"]


@dataclass(frozen=True)
class CriticalError:
    """A stretch of frames in which one object was missed, or was seen where there is none, in a critical conflict."""

    kind: Literal["miss", "false alarm"]
    side: Side
    label: str  # Empty where there is none
    track_id: int | None  # Of truth for a miss, else of the results
    stamp_ns: int  # Of the first frame
    from_s: float  # Since the first scored frame
    to_s: float
    first_frame: int
    last_frame: int
    num_frames: int
    range_m: float  # Least distance from the body, in the ground plane
    ttc_s: float  # Least time to collision
    deceleration_mps2: float  # Largest that the ego would need
    lateral_mps2: float

    @property
    def name(self) -> str:
        """What it is: `car #7`."""
        return f"{self.label or 'object'}{'' if self.track_id is None else f' #{self.track_id}'}"

    @property
    def when(self) -> str:
        """Times since the first scored frame, and the frames."""
        frames = f"frame {self.first_frame}" + (f"-{self.last_frame}" if self.num_frames > 1 else "")
        return f"{self.from_s:.1f}{f'-{self.to_s:.1f}' if self.num_frames > 1 else ''} s, {frames}"

    def __str__(self) -> str:
        effort = f"{self.ttc_s:.1f} s to collision, {self.deceleration_mps2:.1f} m/s² to brake"
        return f"{self.kind}: {self.name} at {self.when}, {self.range_m:.0f} m away: {effort}"


def save_critical_errors(folder: Path, errors: Sequence[CriticalError]) -> None:
    """Write critical errors into a run folder; equal errors give equal bytes."""
    replace_text(folder / FILE, json.dumps([asdict(e) for e in errors], indent=1, allow_nan=False) + "\n")


def load_critical_errors(folder: Path) -> list[CriticalError] | None:
    """Read what `save_critical_errors` wrote; `None` where a run has none of it, as those of older versions. Raises
    RunError where the file isn't a list of critical errors.
    """
    from pydantic import TypeAdapter, ValidationError

    path = folder / FILE
    try:
        return TypeAdapter(list[CriticalError]).validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        why = first_wrong(error) if isinstance(error, ValidationError) else error.strerror
        raise RunError(f"{path}: not a list of critical errors ({why}); score the run again") from error
