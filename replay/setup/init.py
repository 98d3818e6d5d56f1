"""From a log to its `fbench.toml`, with the reasons as comments."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fbench.replay.contracts.entry_points import absolute_name
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.scores import format_count
from fbench.replay.logs.open import open_container
from fbench.replay.logs.roles import SENSOR_WORDS
from fbench.replay.setup.guess_frames import Clocks, frames_table, guess_clocks, guess_reference
from fbench.replay.setup.guess_radar import doppler_lines, period_line
from fbench.replay.setup.guess_rig import Body, calibration_line, guess_body, guess_pose, read_intrinsics
from fbench.replay.setup.guess_sensors import Candidate, choose_sensors
from fbench.replay.setup.guess_truth import classes_table, find_neighbors, results_table, truth_table
from fbench.replay.setup.inspection import Draft, LeftOut, Line, SampledTopic, Table, Value, inspect_log
from fbench.replay.setup.source import name_decoder

_OF_INTEREST = (*SENSOR_WORDS, "depth", "detection", "track", "object", "box", "label", "odom", "pose", "navsat")
_MAX_UNREAD, _MAX_OTHERS = 30, 5
_UPRIGHT = 0.9  # Cosine between two axes that are nearly one


def draft_of(log: Path, config: Path, faults: FaultLog, decoder: Sequence[str] = ()) -> Draft:
    """Look at a log, through these decoders, and say what it most probably holds. Files beside `config`, where the
    configuration will be, are suggested; faults of the log are counted in `faults`. Raises LogError where it can't be
    read, or holds no sensor. Raises ConfigError where a decoder can't be used.
    """
    decoders = tuple(name_decoder(name, is_required=True) for name in decoder)
    found = inspect_log(open_container(log, faults), decoders)
    sensors, left_out = choose_sensors(found.topics)
    if not sensors:
        unread = [item.topic for item in left_out]
        unread += [f"{item.topic} ({item.schema})" if item.schema else item.topic for item in found.unread]
        others = ", ".join(unread[:_MAX_OTHERS]) or "no topics"
        others += f" and {len(unread) - _MAX_OTHERS} more" if len(unread) > _MAX_OTHERS else ""
        advice = "a decoder plug-in reads other types (--decoder)"
        raise LogError(
            f"{log}: holds no camera, LiDAR or radar that fbench can read, only {others}; {advice}", "CHK007"
        )
    intrinsics = read_intrinsics(found.container, found.roles)
    cameras = [s for s in sensors if s.kind == "camera"]
    calibrations = {s.name: line for s in cameras if (line := calibration_line(s, intrinsics)) is not None}
    topics = {name: str(line.value) for name, line in calibrations.items()}
    body = guess_body(found, sensors, topics)
    placed = [s for s in sensors if s.name not in body.left_out] or sensors
    header = found.container.header
    reference = guess_reference(placed, {} if header is None else header.metadata)
    clocks = guess_clocks(placed, str(reference.value))
    poses, pose_lines = guess_pose(found, body)
    boxes_beside, rigs_beside = find_neighbors(config, log)
    if len(body.left_out) == len(sensors):
        reference = replace(reference, is_active=False)
    notes = ("The log says where its sensors are.",) if body.line is None else ()
    body_lines = [*([] if body.line is None else [body.line]), *pose_lines]
    if rigs_beside:
        body_lines.append(Line("rig", rigs_beside, "beside the log; is it its calibration?", is_active=False))
    elif body.problems:
        why = "calibration of sensors that the log has none for"
        body_lines.append(Line("rig", ("rig.toml",), why, is_active=False))
    tables = [
        frames_table(placed, reference, clocks),
        Table(("body",), tuple(body_lines), notes=notes),
        *_sensor_tables(sensors, body, calibrations, clocks, poses),
        truth_table(found, boxes_beside), results_table(found), classes_table(found),
    ]  # fmt: skip
    # Of all that isn't read, only what somebody may miss is named.
    missed = [item for item in found.unread if any(w in f"{item.topic} {item.schema}".lower() for w in _OF_INTEREST)]
    shown = missed[:_MAX_UNREAD]
    rest = len(found.unread) - len(shown)
    more = (LeftOut(f"{rest} more topics", "see fbench log info"),) if rest else ()
    kept = tuple(t for t in tables if t is not None)
    return Draft(found.container.path.name, kept, (*left_out, *shown, *more), _decoder_lines(decoder, config))


def _decoder_lines(decoders: Sequence[str], config: Path) -> tuple[Line, ...]:
    """The decoders as a configuration names them: files in its folder, relative to it, and installed ones."""
    folder, kept, others = config.absolute().parent.resolve(), list[str](), list[str]()
    for name in decoders:
        path, _, function = absolute_name(name).rpartition(":")
        if path and not Path(path).is_relative_to(folder):
            others.append(name)
        else:
            kept.append(f"{Path(path).relative_to(folder).as_posix()}:{function}" if path else name)
    why = "a file runs only if --decoder or --config names it" if any(".py:" in name for name in kept) else ""
    lines = (Line("decoder", tuple(kept), why),) if kept else ()
    outside = Line(
        "decoder", tuple(others), "outside of this folder: give --decoder with each command", is_active=False
    )
    return (*lines, outside) if others else lines


def _sensor_tables(
    sensors: Sequence[Candidate],
    body: Body,
    calibrations: Mapping[str, Line],
    clocks: Clocks,
    poses: SampledTopic | None,
) -> list[Table]:
    doppler, tables = doppler_lines(sensors, body.rig, poses), []
    for s in sensors:
        name, topic = s.name, s.sampled
        rate = f", {topic.rate_text}" if topic.rate_text else ""
        frame = f", coordinate frame '{topic.role.frame_id}'" if topic.role.frame_id and not s.is_own else ""
        num = format_count(topic.num_messages, "message", is_estimate=topic.is_estimate)
        lines = [Line("topic", topic.topic, f"{num}{rate}{frame}")]
        lines.append(Line("kind", s.kind, s.why, s.is_guess))
        is_placed_camera = s.kind == "camera" and not s.is_own and name in body.rig.mounts
        # Cameras look along z, which points up where somebody gave the axes of the housing instead.
        if is_placed_camera and abs(body.rig.body_T_sensor(name)[2, 2]) >= _UPRIGHT:
            why = "its z axis points up or down; that of an optical frame points forward"
            lines.append(Line("frame", topic.role.frame_id, why, is_guess=True))
        if name in body.frames:
            why = "its messages name no coordinate frame; it is assumed at the body's origin, x forward, z up"
            lines.append(Line("frame", body.frames[name], why, is_guess=True))
        if name in calibrations:
            lines.append(calibrations[name])
        if name in clocks.offsets_ms:
            why = "it has another clock; estimated from recording times, up to the delay of its messages"
            lines.append(Line("offset_ms", clocks.offsets_ms[name], why, is_guess=True))
        lines += doppler.get(name, ())
        if s.kind == "radar" and (period := period_line(s)) is not None:
            lines.append(period)
        notes = [f"{name}: {clocks.notes[name]}"] if name in clocks.notes else []
        problem = body.left_out.get(name, "").partition("; add it")[0]
        if name in body.problems and not problem:
            why = body.problems[name].partition("; add it")[0]
            notes.append(f"Its images are used alone, by camera2d: {why}. Calibrate it with [body] rig.")
        if problem:
            advice = "To use it, name a file with its calibration in [body] rig, and remove the '#'."
            notes = [f"Left out: {problem}.", advice]
        tables.append(Table(("sensors", name), tuple(lines), notes=tuple(notes), is_active=not problem))
    return tables


_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\r": "\\r", "\t": "\\t"}
_MAX_COMMENT = 300


@dataclass(frozen=True)
class Placed:
    """Where a line of the draft came to stand."""

    number: int  # Of its line in the file, from 1 on
    table: Table
    line: Line


@dataclass(frozen=True)
class Written:
    """The text, and where its lines are."""

    text: str
    places: tuple[Placed, ...]
    guesses: tuple[Placed, ...]  # Those that somebody should look at


def write_toml(draft: Draft) -> Written:
    """Return the text; any name, whatever is in it, is read back as it was."""
    rows = [f"# What fbench takes from '{_clip(draft.log)}', written by 'fbench init'; every value can be changed."]
    rows += ["# Times are in ms unless a key says otherwise. Check the lines with 'guess'.", "", "version = 1"]
    places: list[Placed] = []
    for table in (Table((), draft.lines), *draft.tables):
        if table.path:
            head = f"{'' if table.is_active else '# '}[{toml_key(table.path)}]"
            rows += ["", *(f"# {_clip(note)}" for note in table.notes), head]
        for line in table.lines:
            row = f"{toml_key((line.key,))} = {toml_value(line.value)}{_comment(line.why, line.is_guess)}"
            rows.append(row if line.is_active and table.is_active else f"# {row}")
            places.append(Placed(len(rows), table, line))
    if draft.left_out:
        rows += ["", "# Not used. To use one of these topics, add a table [sensors.NAME] as above:"]
        rows += [f"#   {_clip(item.topic)}: {_clip(item.why)}" for item in draft.left_out]
    rows += ["", *(f"# {_clip(note)}" for note in draft.notes)] if draft.notes else []
    guesses = tuple(p for p in places if p.line.is_guess and p.line.is_active and p.table.is_active)
    if guesses:
        rows += ["", "# Check these lines and the pictures of 'fbench log preview':"]
        rows += [f"#   {p.number}: {_clip(toml_key((*p.table.path, p.line.key)))}" for p in guesses]
    else:
        rows += ["", "# Nothing here is a guess. 'fbench log preview' shows whether calibration and times are right."]
    return Written("\n".join(rows) + "\n", tuple(places), guesses)


def toml_key(path: tuple[str, ...]) -> str:
    """Return a dotted key, quoted where it must be."""
    return ".".join(part if _BARE.fullmatch(part) else _quote(part) for part in path)


def toml_value(value: Value) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quote(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_quote, value))}]"
    return repr(value)


def plain(text: str) -> str:
    """Return a text that neither ends a line nor steers a terminal."""
    return "".join(c if c.isprintable() else " " for c in text)


def _quote(text: str) -> str:
    quoted = '"'
    for c in text:
        number = 0xFFFD if 0xD800 <= ord(c) <= 0xDFFF else ord(c)  # TOML has no code for half a surrogate pair
        code = f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"
        quoted += _ESCAPES.get(c) or (c if c.isprintable() else code)
    return quoted + '"'


def _clip(text: str) -> str:
    """A text in a comment: nothing in it ends the line."""
    short = plain(text)
    return short if len(short) <= _MAX_COMMENT else short[: _MAX_COMMENT - 1] + "…"


def _comment(why: str, is_guess: bool) -> str:
    if is_guess:
        why = f"guess: {why}; check it" if why else "guess; check it"
    return f"  # {_clip(why)}" if why else ""
