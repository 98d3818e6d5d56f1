"""Lengths of sequences as KITTI's and MOTChallenge's lists of sequences tell them."""

from pathlib import Path

from fbench.replay.boxfiles.text import MAX_FRAMES, frame_number, lines
from fbench.replay.errors import ConfigError, LogError

_KITTI = 4
"""Columns: name, `empty`, first frame, number of frames (`evaluate_tracking.seqmap.training`)."""


def read_seqmap(path: Path) -> dict[str, int | None]:
    """Return how many frames each listed sequence has; `None` where the list has names only, as MOTChallenge's.

    Raises:
        ConfigError: where there is no such file.
        LogError: where a row is neither, or a sequence is listed twice.
    """
    if not path.is_file():
        raise ConfigError(f"--seqmap {path}: no such file")
    found: dict[str, int | None] = {}
    for line in lines(path):
        name = line.fields[0]
        if len(line.fields) not in (1, _KITTI):
            raise LogError(f"{line.where}: {len(line.fields)} columns, expected a name, or: NAME empty 000000 FRAMES")
        if name in found:
            raise LogError(f"{line.where}: sequence '{name[:40]}' twice")
        if len(line.fields) == 1 and line.number == 1 and name == "name":
            continue
        found[name] = min(frame_number(line.fields[3], line.where), MAX_FRAMES) if len(line.fields) == _KITTI else None
    if not found:
        raise LogError(f"{path}: lists no sequence")
    return found
