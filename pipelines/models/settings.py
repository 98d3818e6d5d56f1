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
    recorded: float = 0.5  # Share of views of recordings, where logs of the simulated city are there, too


def chances(weight: Float64, is_recorded: Sequence[bool], recorded: float) -> Float64:
    """How likely each of S samples is to be drawn: by its weight (S,), recordings together with the chance `recorded`
    where there are others, too.
    """
    real = np.array(is_recorded, np.bool_)
    weight = weight / weight.sum()
    share = float(weight[real].sum())
    if real.all() or not real.any():
        return weight
    return np.asarray(np.where(real, weight * recorded / share, weight * (1 - recorded) / (1 - share)), np.float64)
