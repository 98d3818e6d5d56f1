"""Pairs of runs that may be compared, and what else differs between them."""

from collections.abc import Mapping

from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.metadata import SCENE_ID
from fbench.replay.data.scores import format_count
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import Manifest

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
        ("latency", str(base.latency or "none"), str(head.latency or "none")),
        ("networks", str(base.execution), str(head.execution)),
        *((role, files.get(role, "none"), others.get(role, "none")) for role in sorted({*files, *others})),
        *((name, before.get(name, "absent"), after.get(name, "absent")) for name in names),
    ]
    notes = [f"{what}: {a} -> {b}" for what, a, b in changes if a != b]
    if base.execution.cuda != head.execution.cuda:
        notes.append("networks on different devices agree within tolerances, not bit for bit; see docs/determinism.md")
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
    return tuple(
        f"{format_count(num, 'frame')} {'is' if num == 1 else 'are'} at instants that {name} alone has"
        for name, num in alone
        if num
    )


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
            place = "".join(f", in {name}" for name in dict.fromkeys((entry.frame, entry.camera)) if name)
            named.setdefault(role, []).append(f"{entry.name or 'a file'} ({entry.digest[:8]}{place})")
    return {role: ", ".join(entries) for role, entries in named.items()}
