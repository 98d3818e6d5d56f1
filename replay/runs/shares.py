"""Shares of a run: of frames that could be scored, and of detections that its tracker predicted."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.data.scores import format_count
from fbench.replay.runs.columns import column_array
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import read_table

PARAMETER = "detect_every"


@dataclass(frozen=True)
class Predictions:
    """What stands for detections though nothing was detected."""

    num_predicted: int
    num_detections: int  # Predicted ones included
    every: int | None  # Detection ran in every so many-th frame, as the pipeline's parameters say; `None`: they don't

    def __str__(self) -> str:
        """Such as `120 of 400 detections, as detection ran in one frame of 3; scores count them`."""
        why = "" if self.every is None else f", as detection ran in one frame of {self.every}"
        return f"{self.num_predicted} of {self.num_detections} detections{why}; scores count them"


def predictions_of(run: Run) -> Predictions | None:
    """Count them; `None` where all frames were looked at and nothing was predicted, or no frame gave anything."""
    path = run.folder / "detections.parquet"
    if not path.exists():
        return None
    predicted = column_array(read_table(path, ["predicted"]).column("predicted"))
    every = run.manifest.parameters.get(PARAMETER)
    every = every if isinstance(every, int) and every > 1 else None
    num = int(np.count_nonzero(predicted))
    return Predictions(num, len(predicted), every) if num or every else None


@dataclass(frozen=True)
class Coverage:
    """How many outputs of a run had truth: one a frame, of a frame that failed too."""

    num_labeled: int
    num_frames: int
    num_between: int = 0  # Labelled ones that have no truth of their own, but lie between truths

    @property
    def share(self) -> float:
        """From 0 to 1; a run without frames has nothing to label."""
        return self.num_labeled / self.num_frames if self.num_frames else 1.0

    def __str__(self) -> str:
        """Such as `97.8 % of outputs had truth (176 of 180 frames)`."""
        frames = f"{self.num_labeled} of {format_count(self.num_frames, 'frame')}"
        between = f", {self.num_between} of them by interpolation" if self.num_between else ""
        # Only all is 100, and only nothing is 0.
        percent, is_plain = 100 * self.share, self.share in (0.0, 1.0)
        share = f"{percent:.0f}" if is_plain else f"{min(max(percent, 0.1), 99.9):.1f}"
        return f"{share} % of outputs had truth ({frames}{between})"


def coverage_of(run: Run) -> Coverage:
    """How many frames of a run have truth."""
    num_labeled = sum(frame.truth_stamp_ns is not None for frame in run.frames)
    return Coverage(num_labeled, len(run.frames), run.manifest.interpolation.num_frames)
