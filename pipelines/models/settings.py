"""Parameters that all trainings share."""

from dataclasses import dataclass


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
