"""From a log to its `fbench.toml`, with the reasons as comments."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.open import open_container
from fbench.replay.setup.guess_frames import Clocks, frames_table, guess_clocks, guess_reference
from fbench.replay.setup.guess_radar import doppler_lines, period_lines
from fbench.replay.setup.guess_rig import Body, calibration_line, guess_body, guess_pose, intrinsics_of
from fbench.replay.setup.guess_sensors import Candidate, choose
from fbench.replay.setup.guess_truth import Beside, classes_table, look_beside, results_table, truth_table
from fbench.replay.setup.inspection import Draft, Heard, LeftOut, Line, Table, Unread, Value, look_at

_OF_INTEREST = ("scan", "packet", "radar", "lidar", "image", "video", "depth", "cloud", "detection", "track", "object",
                "box", "label", "odom", "pose", "navsat")  # fmt: skip
_MAX_UNREAD = 30
_UPRIGHT = 0.9  # Cosine between two axes that are nearly one


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

    @property
    def guesses(self) -> tuple[Placed, ...]:
        """Those that somebody should look at."""
        return tuple(p for p in self.places if p.line.is_guess and p.line.is_active and p.table.is_active)


def write_toml(draft: Draft) -> Written:
    """Return the text; any name, whatever is in it, is read back as it was."""
    rows = [f"# What fbench takes from '{_shown(draft.log)}', written by 'fbench init'; every value can be changed."]
    rows += ["# Times are in ms unless a key says otherwise. Lines with 'guess' deserve a look.", "", "version = 1"]
    places: list[Placed] = []
    for table in draft.tables:
        rows.append("")
        rows += [f"# {_shown(note)}" for note in table.notes]
        rows.append(_header(table))
        for line in table.lines:
            rows.append(_row(line, table.is_active))
            places.append(Placed(len(rows), table, line))
    rows += _left_out(draft.left_out)
    written = Written("", tuple(places))
    rows += list(_closing(written))
    return Written("\n".join(rows) + "\n", written.places)


def toml_key(path: tuple[str, ...]) -> str:
    """Return a dotted key, quoted where it must be."""
    return ".".join(part if _BARE.fullmatch(part) else _quoted(part) for part in path)


def toml_value(value: Value) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_quoted, value))}]"
    return repr(value)


def plain(text: str) -> str:
    """Return a text that neither ends a line nor steers a terminal."""
    return "".join(c if c.isprintable() else " " for c in text)


def _quoted(text: str) -> str:
    return '"' + "".join(_ESCAPES.get(c) or (c if c.isprintable() else _code(c)) for c in text) + '"'


def _code(character: str) -> str:
    """TOML has no code for half a surrogate pair."""
    number = ord(character)
    if 0xD800 <= number <= 0xDFFF:
        number = 0xFFFD
    return f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def _shown(text: str) -> str:
    """A text in a comment: nothing in it ends the line."""
    short = plain(text)
    return short if len(short) <= _MAX_COMMENT else short[: _MAX_COMMENT - 1] + "…"


def _header(table: Table) -> str:
    row = f"[{toml_key(table.path)}]" + _comment(table.why, table.is_guess)
    return row if table.is_active else f"# {row}"


def _row(line: Line, is_active: bool) -> str:
    row = f"{toml_key((line.key,))} = {toml_value(line.value)}" + _comment(line.why, line.is_guess)
    return row if is_active and line.is_active else f"# {row}"


def _comment(why: str, is_guess: bool) -> str:
    text = f"guess: {why}; check it" if is_guess and why else "guess; check it" if is_guess else why
    return f"  # {_shown(text)}" if text else ""


def _left_out(left_out: tuple[LeftOut, ...]) -> list[str]:
    if not left_out:
        return []
    return ["", "# Left out; to use one after all, give it a table [sensors.NAME] as above:"] + [
        f"#   {_shown(item.topic)}: {_shown(item.why)}" for item in left_out
    ]


def _closing(written: Written) -> Iterator[str]:
    yield ""
    if not written.guesses:
        yield "# Nothing here is a mere guess. 'fbench log preview' shows whether calibration and times are right."
        return
    yield "# Look at these lines, and at the pictures of 'fbench log preview':"
    for place in written.guesses:
        yield f"#   {place.number}: {_shown(toml_key((*place.table.path, place.line.key)))}"
