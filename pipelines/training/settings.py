"""What a training is made from: nothing else decides it, apart from machine and versions."""

from dataclasses import dataclass

CLASSES = ("car", "van", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
"""Labels that the detector tells apart, in the order of its outputs."""
INPUT_WH = (640, 480)
"""Width and height of the finished detector's input [px]."""


@dataclass(frozen=True)
class TrainingSettings:
    """Parameters of a training."""

    seed: int = 1
    steps: int = 8000
    """Batches; every `whole_every`-th is one of whole images."""
    crops: int = 12
    """Crops in a batch."""
    crop_wh: tuple[int, int] = (320, 256)
    """Size of a crop [px of the network's input]."""
    wholes: int = 3
    """Whole images in a batch."""
    whole_every: int = 5
    zoom: tuple[float, float] = (0.55, 1.4)
    """Range of the scale of a crop, times the scale of a whole image in the network's input; drawn evenly in log."""
    learning_rate: float = 4.0e-3
    warm_up: int = 150
    """Steps over which the learning rate rises."""
    weight_decay: float = 0.02
    average: float = 0.9985
    """How much of the averaged weights each step keeps; these are the ones that are exported."""
    checkpoint_every: int = 100
    """Steps."""
