"""In which images of a rig something can be found by projecting into them."""

from fbench.replay.data import LogInfo, Rig
from fbench.replay.errors import LogError
from fbench.replay.geometry.camera import not_projectable


def projectable(pipeline: str, rig: Rig, log_info: LogInfo) -> tuple[str, ...]:
    """Names of the cameras of a rig that can be projected into; their images aren't needed.

    Raises:
        LogError: where there is none, saying why.
    """
    names = rig.sensors("camera")
    if not names:
        raise LogError(f"log '{log_info.name}': {pipeline} works in images, and the rig has no camera", "CFG001")
    why = {name: _reason(rig, name) for name in names}
    good = tuple(name for name in names if why[name] is None)
    if not good:
        raise LogError(f"log '{log_info.name}': {pipeline} can't project into camera '{names[0]}': {why[names[0]]}",
                       "CAL001")  # fmt: skip
    return good


def _reason(rig: Rig, name: str) -> str | None:
    return not_projectable(rig.cameras[name]) if name in rig.cameras else "the log has no intrinsics of it"
