"""Whether two runs are of one thing, and what else differs between them."""

from collections.abc import Mapping

from fbench.replay.errors import MetricError
from fbench.replay.log_keys import SCENE_ID
from fbench.replay.manifest import InputEntry, Manifest, TruthEntry
from fbench.replay.store import Run

_MAX_CHARS = 40
"""Longer values of metadata say no more in a note."""


def require_comparable(base: Manifest, head: Manifest) -> tuple[str, ...]:
    """Refuse to compare runs of logs that show different things; returns notes on what else differs.

    Logs are comparable where they are equal, or where their metadata say that they show one scene: the same drive with
    the same truth, under other weather or with other sensors.

    Raises:
        MetricError: where the logs show different things, naming both.
    """
    other = _other_log(base, head) if base.log.digest != head.log.digest else []
    notes = [f"{what}: {a} -> {b}" for what, a, b in (*other, *_settings(base, head)) if a != b]
    partial = [f"{name} is incomplete" for name, run in (("base", base), ("head", head)) if not run.complete]
    return (*notes, *partial)


def require_common_instants(base: Run, head: Run) -> tuple[str, ...]:
    """Refuse to compare runs of different logs that have no frame of one instant; returns notes on frames of one alone.

    Sensors lose messages, and others have other rates.

    Raises:
        MetricError: where they have none in common.
    """
    if base.manifest.log.digest == head.manifest.log.digest:
        return ()
    before, after = ({frame.stamp_ns for frame in run.frames} for run in (base, head))
    if not before & after:
        raise MetricError(
            "runs without a frame at the same instant can't be compared; give their reference sensors the same rate "
            "and phase"
        )
    alone = ((name, len(stamps)) for name, stamps in (("base", before - after), ("head", after - before)))
    return tuple(f"{num} frames are at instants that {name} alone has" for name, num in alone if num)


def _other_log(base: Manifest, head: Manifest) -> list[tuple[str, object, object]]:
    """What two logs of one scene say of themselves, and their sensors."""
    a, b = base.log.metadata, head.log.metadata
    if not a.get(SCENE_ID) or a.get(SCENE_ID) != b.get(SCENE_ID):
        raise MetricError(
            f"runs of different logs can't be compared: base is {_log(base)}, head is {_log(head)}; "
            "replay both on one log, or on simulated logs of one scene"
        )
    keys = [*a, *(key for key in b if key not in a)]
    return [
        ("log", _log(base), _log(head)),
        *((key, _short(a, key), _short(b, key)) for key in keys if a.get(key) != b.get(key)),
        ("sensors", ", ".join(base.mounts), ", ".join(head.mounts)),
        *_calibration(base, head),
    ]


def _calibration(base: Manifest, head: Manifest) -> list[tuple[str, object, object]]:
    a, b = ({n: (mount, m.cameras.get(n)) for n, mount in m.mounts.items()} for m in (base, head))
    changed = [name for name in a if name in b and a[name] != b[name]]
    return [(f"calibration of {', '.join(changed)}", "one", "another")] if changed else []


def _short(metadata: Mapping[str, str], key: str) -> str:
    text = metadata.get(key, "absent")
    return text if len(text) <= _MAX_CHARS else f"{text[:_MAX_CHARS]}..."


def _settings(base: Manifest, head: Manifest) -> list[tuple[str, object, object]]:
    before, after = ({**m.parameters, **m.frames.model_dump()} for m in (base, head))
    names = [*before, *(name for name in after if name not in before)] if base.pipeline == head.pipeline else []
    files, others = _files(base), _files(head)
    return [
        ("pipeline", base.pipeline, head.pipeline),
        ("frames", base.num_frames, head.num_frames),
        *((role, files.get(role, "none"), others.get(role, "none")) for role in sorted({*files, *others})),
        *((name, before.get(name, "absent"), after.get(name, "absent")) for name in names),
    ]


def _files(manifest: Manifest) -> dict[str, str]:
    """What files beside the log say, by their role; equal names may have other content."""
    named: dict[str, list[str]] = {"truth": [_file(manifest.truth)]} if manifest.truth else {}
    for entry in manifest.inputs:
        named.setdefault(entry.role, []).append(_file(entry))
    return {role: ", ".join(entries) for role, entries in named.items()}


def _file(entry: InputEntry | TruthEntry) -> str:
    return f"{entry.name or 'a file'} ({entry.digest[:8]})"


def _log(manifest: Manifest) -> str:
    return f"'{manifest.log.name}' ({manifest.log.digest[:12]})"
