"""Every pipeline on a recording, each with one command: which run, and what those say whose sensor isn't there."""

from collections.abc import Collection
from pathlib import Path

import pytest
from tests.program import fbench

from fbench.replay.runs.folder import Run

ALONE = {
    "camera2d": "camera", "lidar2d": "lidar", "radar2d": "radar", "lidar3d": "lidar", "radar3d": "radar",
    "stereo3d": "stereo", "track": "results", "thesis/camera2d": "camera", "thesis/lidar2d": "lidar",
    "thesis/radar2d": "radar", "thesis/lidar3d": "lidar", "thesis/radar3d": "radar", "thesis/early3d-stereo": "stereo",
}  # fmt: skip
"""What pipelines can't do without."""
FUSIONS = ("early2d", "early3d", "late2d", "late3d")
"""Any LiDAR or radar is enough for these, and for the thesis's."""
PIPELINES = (*ALONE, *FUSIONS, *(f"thesis/{name}" for name in FUSIONS))
MISSING = {
    "radar": "needs a radar; the log has: ", "stereo": "needs two cameras of one size",
    "results": "which topic holds the results? there is none",
}  # fmt: skip


def require_runs_or_says_why(
    log: Path, pipeline: str, sensors: Collection[str], num_frames: int, shared: Path, said: pytest.CaptureFixture[str]
) -> Run | None:
    """Replay the first frames of a log whose sensors are `sensors`; returns nothing where it rightly was refused."""
    needed, out = ALONE.get(pipeline, "lidar"), log.parent / pipeline.replace("/", "-")
    weights = shared / "weights/deimv2_femto/deimv2_hgnetv2_femto_coco.onnx"
    uses_camera = needed == "camera" or pipeline.endswith(("-stereo", *FUSIONS))
    settings = ["--set", f"camera.weights={weights}"] if uses_camera else []
    code = fbench("replay", log, "-p", pipeline, *settings, "--frames", f":{num_frames}", "-o", out)
    if needed not in sensors:
        assert code == 3
        assert MISSING[needed] in said.readouterr().err
        assert not out.exists()
        return None
    assert code == 0, said.readouterr().err
    run = Run(out)
    assert run.manifest.complete
    assert run.manifest.num_frames == num_frames
    assert not any(frame.failed for frame in run.frames)
    assert not any(reason == "no weights" for frame in run.frames for reason in frame.missing.values())
    return run
