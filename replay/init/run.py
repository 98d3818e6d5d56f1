"""From a log to the draft of its configuration."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.init.beside import Beside, look_beside
from fbench.replay.init.draft import Draft, LeftOut, Line, Table
from fbench.replay.init.guess_aliasing import period_lines
from fbench.replay.init.guess_body import Body, guess_body
from fbench.replay.init.guess_boxes import classes_table, results_table, truth_table
from fbench.replay.init.guess_calibration import calibration_line, intrinsics_of
from fbench.replay.init.guess_clocks import Clocks, guess_clocks
from fbench.replay.init.guess_doppler import doppler_lines
from fbench.replay.init.guess_frames import frames_table, guess_reference
from fbench.replay.init.guess_pose import guess_pose
from fbench.replay.init.guess_sensors import Candidate, choose
from fbench.replay.init.look import Heard, Unread, look_at
from fbench.replay.logs.open import open_container

_OF_INTEREST = ("scan", "packet", "radar", "lidar", "image", "video", "depth", "cloud", "detection", "track", "object",
                "box", "label", "odom", "pose", "navsat")  # fmt: skip
_MAX_UNREAD = 30
_UPRIGHT = 0.9
"""Cosine between two axes that are nearly one."""


def draft_of(log: Path, config: Path, faults: FaultLog) -> Draft:
    """Look at a log and say what it most probably holds.

    Args:
        log: The log.
        config: Where the configuration will be; files beside it are suggested.
        faults: Where faults of the log are counted.

    Raises:
        LogError: where it can't be read, or holds no sensor.
    """
    look = look_at(open_container(log, faults))
    choice = choose(look.heard)
    if not choice.sensors:
        others = ", ".join(item.topic for item in choice.left_out[:5]) or f"{len(look.container.channels)} other topics"
        raise LogError(f"{log}: holds no camera, LiDAR or radar that fbench can read, only {others}", "CHK007")
    intrinsics = intrinsics_of(look.container, look.roles)
    calibrations = {s.name: line for s in choice.sensors if (line := calibration_line(s, intrinsics)) is not None}
    named = {name: str(line.value) for name, line in calibrations.items()}
    body = guess_body(look.container, look.roles, choice.sensors, named)
    placed = [s for s in choice.sensors if s.name not in body.problems]
    reference = guess_reference(placed or choice.sensors, look.metadata)
    clocks = guess_clocks(placed or choice.sensors, str(reference.value))
    pose = guess_pose(look, body)
    beside = look_beside(config, log)
    tables = [
        frames_table(placed or choice.sensors, reference, clocks),
        _body_table(body, pose.lines, beside),
        *_sensor_tables(choice.sensors, body, calibrations, clocks, pose.chosen),
        truth_table(look, beside), results_table(look), classes_table(look),
    ]  # fmt: skip
    left_out = (*choice.left_out, *_unread(look.unread))
    return Draft(log.name, tuple(t for t in tables if t is not None), left_out)


def _body_table(body: Body, poses: Sequence[Line], beside: Beside) -> Table:
    first = [] if body.line is None else [body.line]
    notes = ("The log says where its sensors are.",) if body.line is None else ()
    files = beside.rigs or (("rig.toml",) if body.problems else ())
    why = (
        "beside the log; is it its calibration?" if beside.rigs else "calibration of sensors that the log has none for"
    )
    rigs = [Line("rig", files, why, is_active=False)] if files else []
    return Table(("body",), (*first, *poses, *rigs), notes=notes)


def _sensor_tables(
    sensors: Sequence[Candidate], body: Body, calibrations: Mapping[str, Line], clocks: Clocks, poses: Heard | None
) -> list[Table]:
    doppler, periods = doppler_lines(sensors, body.rig, poses), period_lines(sensors)
    tables = []
    for s in sensors:
        own = [_frame_line(s, body), calibrations.get(s.name), clocks.offset_line(s.name), *doppler.get(s.name, ())]
        own.append(periods.get(s.name))
        lines = (_topic_line(s), Line("kind", s.kind, s.why, s.is_guess), *(line for line in own if line is not None))
        problem = body.problems.get(s.name, "").partition("; add it")[0]
        notes = [
            f"Left out: {problem}.",
            "To use it, name a file with its calibration in [body] rig, and remove the '#'.",
        ]
        odd = [f"{s.name}: {clocks.notes[s.name]}"] if s.name in clocks.notes else []
        tables.append(Table(("sensors", s.name), lines, notes=tuple(notes if problem else odd), is_active=not problem))
    return tables


def _frame_line(sensor: Candidate, body: Body) -> Line | None:
    """Cameras look along z, which points up where somebody gave the axes of the housing instead."""
    if sensor.kind != "camera" or sensor.is_own or sensor.name not in body.rig.mounts:
        return None
    if abs(body.rig.body_T_sensor(sensor.name)[2, 2]) < _UPRIGHT:
        return None
    frame = sensor.heard.role.frame_id
    return Line("frame", frame, "its z axis points up or down, but that of an optical frame forward", is_guess=True)


def _topic_line(sensor: Candidate) -> Line:
    heard = sensor.heard
    period_ns = heard.period_ns
    rate = "" if period_ns is None else f", {1e9 / period_ns:.1f} Hz"
    frame = f", coordinate frame '{heard.role.frame_id}'" if heard.role.frame_id and not sensor.is_own else ""
    return Line("topic", heard.topic, f"{heard.num_messages} messages{rate}{frame}")


def _unread(unread: Sequence[Unread]) -> list[LeftOut]:
    """Topics that somebody may miss."""
    missed = [u for u in unread if any(word in f"{u.topic} {u.schema}".lower() for word in _OF_INTEREST)]
    shown = [LeftOut(u.topic, u.why) for u in missed[:_MAX_UNREAD]]
    rest = len(unread) - len(shown)
    return [*shown, LeftOut(f"{rest} more topics", "see fbench log info")] if rest else shown
