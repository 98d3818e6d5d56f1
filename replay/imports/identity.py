"""Ids of imported logs: equal files and options give equal ids, wherever the files lie."""

from collections.abc import Iterable, Mapping
from hashlib import blake2b
from pathlib import Path

from fbench.replay.imports.wish import FrameRange
from fbench.replay.settings import describe


def log_id(dataset: str, facts: Iterable[str], frames: FrameRange, params: object = None) -> str:
    """Return the id of a log.

    Args:
        dataset: Short name of the dataset, with which the id begins.
        facts: What tells the source apart, in a fixed order: names and sizes of files (`file_facts`), tokens.
        frames: Which frames were imported.
        params: The importer's parameters.
    """
    digest = blake2b(digest_size=8)
    own = [f"{name}={value}" for name, value in sorted(described(params).items())]
    for text in [*facts, str(frames), *own]:
        data = text.encode(errors="surrogateescape")
        digest.update(len(data).to_bytes(8, "little") + data)
    return f"{dataset}-{digest.hexdigest()}"


def file_facts(root: Path, paths: Iterable[Path]) -> list[str]:
    """Return name below `root` and size of each file; of one that isn't there the name."""
    facts = []
    for path in paths:
        size = path.stat().st_size if path.is_file() else "missing"
        facts.append(f"{path.relative_to(root).as_posix()} {size}")
    return facts


def described(params: object) -> Mapping[str, str]:
    """Return an importer's parameters as metadata of the log, `import.NAME`; those that are left open are left out."""
    if params is None:
        return {}
    return {f"import.{name}": str(value) for name, value in describe(params).items() if value not in (None, "")}
