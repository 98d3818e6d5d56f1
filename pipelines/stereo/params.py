"""Parameters of depth by stereo."""

from dataclasses import dataclass, field

from fbench.pipelines.stereo.depth import DepthParams
from fbench.pipelines.stereo.disparity import DisparityParams
from fbench.pipelines.stereo.quality import QualityParams


@dataclass(frozen=True)
class StereoParams:
    """Parameters of depth by stereo."""

    left: str | None = None
    """Name of the left camera; none: that of the pair with the longest baseline."""
    right: str | None = None
    """Name of the right camera; none: see `left`."""
    disparity: DisparityParams = field(default_factory=DisparityParams)
    """How the images are matched."""
    quality: QualityParams = field(default_factory=QualityParams)
    """When depth is taken for noise."""
    depth: DepthParams = field(default_factory=DepthParams)
    """What depth becomes."""
