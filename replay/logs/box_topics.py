"""Finding the topic that holds the results of another system."""

from collections.abc import Mapping
from pathlib import Path

from fbench.replay.errors import LogError
from fbench.replay.logs.foxglove.topics import RESULTS2D, RESULTS3D
from fbench.replay.logs.roles import Role
from fbench.replay.names import did_you_mean


def box_channels(roles: Mapping[int, Role], topic: str, log: Path) -> frozenset[int]:
    """Return the channels of a topic with boxes; without a name, of the only one with results.

    Raises:
        LogError: where there is no such topic, or several without a name.
    """
    boxes = {id_: role for id_, role in sorted(roles.items()) if role.kind in ("detections", "truth")}
    known = sorted({role.topic for role in boxes.values()})
    if not topic:
        named = {role.topic for role in boxes.values() if role.kind == "detections"}
        # Of one system's boxes in 3D and in images, which importers keep on two topics, those in 3D are meant.
        results = sorted(named - ({RESULTS2D} if RESULTS3D in named else set()))
        if len(results) != 1:
            raise LogError(f"{log}: which topic holds the results? {_choice(results, known)}", "CFG001")
        topic = results[0]
    found = frozenset(id_ for id_, role in boxes.items() if topic in (role.topic, role.sensor))
    if not found:
        raise LogError(f"{log}: no topic '{topic}' with boxes{did_you_mean(topic, known)}", "CFG001")
    return found


def _choice(results: list[str], known: list[str]) -> str:
    """Say which topics with results there are, and where there are none, what else there is."""
    if results:
        return f"there are: {', '.join(results)}"
    truth = f", only truth: {', '.join(known)}" if known else " with boxes"
    return f"there is none{truth}; `fbench replay --detections PATH` takes them from elsewhere"
