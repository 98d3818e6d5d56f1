"""Parameters that all trainings share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Float64


@dataclass(frozen=True)
class LoopSettings:
    """Parameters of the loop of a training."""

    seed: int = 1
    steps: int = 8000  # Batches
    learning_rate: float = 4.0e-3
    warm_up: int = 150  # Steps over which the learning rate rises.
    weight_decay: float = 0.02
    average: float = 0.9985  # How much of the averaged weights each step keeps; these are the ones that are exported.
    checkpoint_every: int = 100  # Steps.
    recorded_share: float = 0.5  # Of views, from recordings where there are simulated logs, too


def chances(weight: Float64, is_recorded: Sequence[bool], recorded_share: float) -> Float64:
    """Return the probability (S,) that each sample is drawn: by its weight (S,), but recordings together have the given
    share where there are others, too.
    """
    recorded = np.array(is_recorded, np.bool_)
    weight = weight / weight.sum()
    if recorded.all() or not recorded.any():
        return weight
    own = float(weight[recorded].sum())
    factor = np.where(recorded, recorded_share / own, (1 - recorded_share) / (1 - own))
    return np.asarray(weight * factor, np.float64)
