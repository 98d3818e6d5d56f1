"""Which detections of a run are predictions of its tracker: what `--detect-every` leaves to it."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.store import Run
from fbench.replay.tables import column_array, read_table

PARAMETER = "detect_every"


@dataclass(frozen=True)
class Predictions:
    """What stands for detections though nothing was detected."""

    num_predicted: int
    num_detections: int
    """Predicted ones included."""
    every: int | None
    """Detection ran in every so many-th frame, as the pipeline's parameters say; `None`: they don't."""

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
