"""Depth by one stereo pair of a rig, timed: from a frame to points in body coordinates."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.stages import StageClock
from fbench.pipelines.stereo import quality
from fbench.pipelines.stereo.depth import points
from fbench.pipelines.stereo.disparity import Matcher
from fbench.pipelines.stereo.params import StereoParams
from fbench.pipelines.stereo.rectify import chosen_pair, rectifier
from fbench.replay.arrays import Float64
from fbench.replay.data import Fault, Frame, Image, Rig
from fbench.replay.images import Pixels, decode_grey

NOISE = "stereo depth is noise"
"""Why stereo is left out of a frame whose images match too badly."""


@dataclass(frozen=True, eq=False)
class StereoView:
    """Depth of one frame."""

    xyz: Float64
    """(N, 3) [m] in body coordinates, in lexicographic order; none where stereo is off, or an image is missing."""
    sure_share: float | None = None
    """Share of pixels on the ground and what stands there that are surely matched; `None` where an image is missing."""
    is_off: bool = False
    """Whether both images are there but their depth is taken for noise."""


class StereoStage:
    """Finds depth with one pair of cameras; a frame's depth depends on that frame alone.

    Raises:
        ConfigError: where a camera that is named isn't there.
        LogError: where the rig has no stereo pair, or what it has can't be rectified.
    """

    def __init__(self, rig: Rig, log_name: str, params: StereoParams) -> None:
        self._params = params
        self._sizes = {name: camera.size_wh for name, camera in rig.cameras.items()}
        self.pair = chosen_pair(rig, log_name, params.left, params.right)
        """The cameras that are used."""
        self._how = rectifier(rig, self.pair, params.disparity.shrink)
        camera, self.eye_m = self._how.camera, self._how.body_T_camera[:2, 3]
        self._matcher = Matcher(float(camera.K[0, 0]), self._how.baseline_m, camera.size_wh[0], params.disparity)
        self.focal_baseline = float(camera.K[0, 0]) * self._how.baseline_m
        """f B [px m] of the shrunk images: Z = f B / d."""

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> StereoView:
        """Find the depth of one frame; a corrupt image is a fault and counts as missing."""
        with clock.stage("decode"):
            images = [self._pixels(frame, name, faults) for name in (self.pair.left, self.pair.right)]
        if images[0] is None or images[1] is None:
            return StereoView(np.zeros((0, 3)))
        with clock.stage("preprocess"):
            left, right = self._how.images(images[0], images[1])
        with clock.stage("detect.stereo"):
            texture = self._matcher.texture(left)
            disparity = self._matcher.disparity(left, right, texture)
            end = quality.last_row(disparity, self._how, self._matcher.num_px)
            share = quality.sure_share(left, right, disparity, texture, self._how, end, self._params.quality)
        if share < self._params.quality.min_share:
            return StereoView(np.zeros((0, 3)), share, True)
        with clock.stage("calibrate"):
            nearest_m = max(self._params.disparity.nearest_m, self.focal_baseline / self._matcher.num_px)
            disparity[end:] = np.nan
            return StereoView(points(disparity, self._how, nearest_m, self._params.depth), share)

    def _pixels(self, frame: Frame, name: str, faults: list[Fault]) -> Pixels | None:
        image = frame.messages.get(name)
        if not isinstance(image, Image):
            return None
        pixels = decode_grey(image)
        if pixels is None:
            faults.append(Fault("DEC002", f"{name} at stamp {image.stamp_ns}"))
        elif pixels.shape[1::-1] != self._sizes[name]:
            faults.append(Fault("LIM003", f"{name} at stamp {image.stamp_ns}"))
            return None
        return pixels
