"""From a camera's message to detections: the steps that all pipelines with cameras share."""

from fbench.pipelines.camera.detector import CameraDetections, CameraDetector
from fbench.pipelines.stages import StageClock
from fbench.replay.data import Fault, Image
from fbench.replay.images import decode


def look(
    detector: CameraDetector, image: Image, clock: StageClock, faults: list[Fault], share: float = 1.0
) -> CameraDetections | None:
    """Detect road users in one image; where it is corrupt, append a fault and return `None`.

    With a `share` below 1 also those that other sensors may confirm: down to that share of the camera's `min_score`.

    Timed as `decode`, `preprocess` and `detect.camera`.

    Raises:
        ModelError: where the model fails.
    """
    with clock.stage("decode"):
        pixels = decode(image)
    if pixels is None:
        faults.append(Fault("DEC002", f"{image.sensor} at stamp {image.stamp_ns}"))
        return None
    with clock.stage("preprocess"):
        prepared = detector.prepare(pixels)
    with clock.stage("detect.camera"):
        return detector.infer(prepared, share)
