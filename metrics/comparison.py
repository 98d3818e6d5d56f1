"""Comparison of two runs: what became better, what worse, and whether that is a regression."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from fbench.metrics.definitions.catalog import DEFINITIONS, Better
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.data.metadata import SCENE_ID
from fbench.replay.data.scores import Score
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import Manifest

Verdict = Literal["same", "better", "worse", "changed", "gone", "new", "null"]
"""`changed`: of a number that is neither good nor bad."""

_DECISIVE = ("f1", "mota")
_ROUNDING = 1e-12  # 0.80 - 0.79 is a little more than 0.01 in binary


@dataclass(frozen=True)
class Row:
    """One number of both runs."""

    metric: str
    class_: str
    slice: str
    matching: str
    unit: str
    base: float | None
    head: float | None
    delta: float | None  # `head - base`, where both have a value
    verdict: Verdict
    primary: bool  # Whether it decides about regression


@dataclass(frozen=True)
class Comparison:
    """All rows, the base's order first."""

    rows: tuple[Row, ...]
    tolerance: float

    @property
    def is_worse(self) -> bool:
        """Whether a primary number fell by more than the tolerance, or lost its value."""
        return any(
            row.primary and (row.verdict in ("worse", "gone") or (row.base is not None and row.head is None))
            for row in self.rows
        )


def compare(base: Sequence[Score], head: Sequence[Score], tolerance: float) -> Comparison:
    """Compare the scores of two runs: `base`, what is compared with, primary rows first, and `head`, what is judged.

    Primary are F1 and MOTA (higher is better) of the base's first row: its class, slice and matching. Up to a change of
    `tolerance`, in the number's unit, a number counts as the same. Raises ConfigError where that isn't a number from 0
    on. Raises MetricError where the two have no primary row in common, so that nothing can be said.
    """
    if not tolerance >= 0:
        raise ConfigError(f"tolerance {tolerance}: expected a number from 0 on")
    before, after = {s.key: s for s in base}, {s.key: s for s in head}
    firsts = [next((s for s in scores if s.metric in _DECISIVE), None) for scores in (base, head)]
    primary = [s.key for s in base if s.metric in _DECISIVE and firsts[0] and s.key[1:] == firsts[0].key[1:]]
    if not any(key in after for key in primary):
        names = [f"{s.metric} of {s.class_} ({s.matching})" if s else "neither f1 nor mota" for s in firsts]
        raise MetricError(
            f"nothing to compare: base has {names[0]}, head has {names[1]}; "
            "score both with the same options, and compare 3D with 3D, 2D with 2D"
        )
    if all(before[key].value is None for key in primary):
        raise MetricError(f"nothing to compare: base has no value of f1 or mota ({before[primary[0]].reason})")
    rows = []
    for key in {**before, **after}:
        one, other = before.get(key), after.get(key)
        a, b = (None if score is None else score.value for score in (one, other))
        delta = None if a is None or b is None else b - a
        unit = next(score.unit for score in (other, one) if score)
        rows.append(Row(*key, unit, a, b, delta, _verdict(one, other, delta, tolerance), key in primary))
    return Comparison(tuple(rows), tolerance)


def _verdict(base: Score | None, head: Score | None, delta: float | None, tolerance: float) -> Verdict:
    if base is None:
        return "new"
    if head is None:
        return "gone"
    if delta is None:
        return "null"
    if abs(delta) <= tolerance + _ROUNDING:
        return "same"
    wanted: Better = DEFINITIONS[head.metric].better if head.metric in DEFINITIONS else "higher"
    if head.unit == "m":  # a distance is an error, whatever the metric is in another unit
        wanted = "lower"
    if wanted == "neither":
        return "changed"
    return "better" if (delta < 0) == (wanted == "lower") else "worse"


_MAX_CHARS = 40  # Longer values of metadata say no more in a note


def require_comparable(base: Manifest, head: Manifest) -> tuple[str, ...]:
    """Refuse to compare runs of logs that show different things; returns notes on what else differs.

    Logs are comparable where they are equal, or where their metadata say that they show one scene: the same drive with
    the same truth, under other weather or with other sensors; or where conditions disturbed one log. Raises MetricError
    where the logs show different things, naming both.
    """
    is_disturbed = bool(base.conditions or head.conditions) and base.log.log_id == head.log.log_id
    is_same = is_disturbed or base.log.digest == head.log.digest
    changes = [] if is_same else _compare_logs(base, head)
    before, after = ({**m.parameters, **m.frames.model_dump()} for m in (base, head))
    names = {**before, **after} if base.pipeline == head.pipeline else {}
    files, others = _files(base), _files(head)
    changes += [
        ("pipeline", base.pipeline, head.pipeline),
        ("frames", base.num_frames, head.num_frames),
        ("conditions", _conditions(base), _conditions(head)),
        *((role, files.get(role, "none"), others.get(role, "none")) for role in sorted({*files, *others})),
        *((name, before.get(name, "absent"), after.get(name, "absent")) for name in names),
    ]
    notes = [f"{what}: {a} -> {b}" for what, a, b in changes if a != b]
    partial = [f"{name} is incomplete" for name, run in (("base", base), ("head", head)) if not run.complete]
    return (*notes, *partial)


def _conditions(manifest: Manifest) -> str:
    names = "+".join(map(str, manifest.conditions))
    return f"{names}, seed {manifest.seed}" if names else "none"


def require_common_instants(base: Run, head: Run) -> tuple[str, ...]:
    """Refuse to compare runs of different logs that have no frame of one instant; returns notes on frames of one alone.

    Sensors lose messages, and others have other rates. Raises MetricError where they have none in common.
    """
    if base.manifest.log.digest == head.manifest.log.digest:
        return ()
    before, after = ({frame.stamp_ns for frame in run.frames} for run in (base, head))
    if not before & after:
        what = "runs without a frame at the same instant can't be compared"
        raise MetricError(f"{what}; give their reference sensors the same rate and phase")
    alone = ((name, len(stamps)) for name, stamps in (("base", before - after), ("head", after - before)))
    return tuple(f"{num} frames are at instants that {name} alone has" for name, num in alone if num)


def _compare_logs(base: Manifest, head: Manifest) -> list[tuple[str, object, object]]:
    """Changes between two logs of one scene, what they say of themselves, and their sensors."""
    a, b = base.log.metadata, head.log.metadata
    base_log, head_log = (f"'{run.log.name}' ({run.log.digest[:12]})" for run in (base, head))
    if not a.get(SCENE_ID) or a.get(SCENE_ID) != b.get(SCENE_ID):
        raise MetricError(
            f"runs of different logs can't be compared: base is {base_log}, head is {head_log}; "
            "replay both on one log, or on simulated logs of one scene"
        )
    one, other = ({n: (mount, m.cameras.get(n)) for n, mount in m.mounts.items()} for m in (base, head))
    moved = [name for name in one if name in other and one[name] != other[name]]
    return [
        ("log", base_log, head_log),
        *((key, _short(a, key), _short(b, key)) for key in {**a, **b} if a.get(key) != b.get(key)),
        ("sensors", ", ".join(base.mounts), ", ".join(head.mounts)),
        *([(f"calibration of {', '.join(moved)}", "one", "another")] if moved else []),
    ]


def _short(metadata: Mapping[str, str], key: str) -> str:
    text = metadata.get(key, "absent")
    return text if len(text) <= _MAX_CHARS else f"{text[:_MAX_CHARS]}..."


def _files(manifest: Manifest) -> dict[str, str]:
    """What files beside the log say, by their role; equal names may have other content."""
    named: dict[str, list[str]] = {}
    for role, entry in [("truth", manifest.truth), *((entry.role, entry) for entry in manifest.inputs)]:
        if entry is not None:
            named.setdefault(role, []).append(f"{entry.name or 'a file'} ({entry.digest[:8]})")
    return {role: ", ".join(entries) for role, entries in named.items()}
