"""Which topic says where the body is in the world."""

from dataclasses import dataclass

from fbench.replay.errors import LogError
from fbench.replay.init.draft import Line
from fbench.replay.init.guess_body import Body
from fbench.replay.init.look import Heard, Look
from fbench.replay.logs.read_rig import first_state
from fbench.replay.logs.tf_poses import TfSource


@dataclass(frozen=True, eq=False)
class PoseChoice:
    """The topic that is taken, and what is said about it and the others."""

    chosen: Heard | None
    lines: tuple[Line, ...]


def guess_pose(look: Look, body: Body) -> PoseChoice:
    """Take the topic with the highest rate of those that give the body's own pose, else of all."""
    found = [
        h for h in look.heard if h.role.kind in ("pose", "odometry") and h.num_messages and any(s.pose for s in h.seen)
    ]
    if not found:
        return PoseChoice(None, _from_transforms(look))
    name = "" if body.line is None else str(body.line.value)
    order = sorted(found, key=lambda h: (h.role.frame_id not in ("", name), -h.num_messages, h.topic))
    best, others = order[0], order[1:]
    if best.role.is_own and not others:
        return PoseChoice(best, ())
    of = f", of '{best.role.frame_id}'" if best.role.frame_id else ""
    is_certain = best.role.kind == "pose" or best.role.frame_id == name
    more = ", the most frequent one" if others else ""
    line = Line("pose", best.topic, f"{best.schema}, {best.num_messages} messages{of}{more}", is_guess=not is_certain)
    rest = tuple(Line("pose", h.topic, f"{h.schema}, {h.num_messages} messages", is_active=False) for h in others)
    return PoseChoice(best, (line, *rest))


def _from_transforms(look: Look) -> tuple[Line, ...]:
    """A topic with transforms that move, where they say where the body is."""
    topics = sorted({r.topic for r in look.roles.values() if r.kind == "transform" and not r.is_static})
    for topic in topics:
        try:
            world = TfSource(look.container, look.roles, topic, lambda: first_state(look.container, look.roles)).world
        except LogError:
            continue
        return (Line("pose", topic, f"its transforms say where the body is in '{world}'"),)
    return ()
