"""Recognition of the formats of boxes by names and content, without what reads them."""

from pathlib import Path

from fbench.replay.contracts.errors import LogError
from fbench.replay.formats.documents import head_of
from fbench.replay.formats.text import is_number

SUFFIXES = (".csv", ".tsv", ".parquet", ".feather")  # Of tables
COMPANIONS = ("sample.json", "samples.csv")  # What tells when samples are, beside a submission of nuScenes
AB3DMOT_COLUMNS = 15  # Frame, number of the class, then 13 numbers
_MAX_INSPECTED = 20


def recognize(path: Path) -> str:
    """Return the name of the form. Raises LogError where it can't be told."""
    form = _recognize_folder(path) if path.is_dir() else _recognize_file(path)
    if form is None:
        forms = "table .csv .parquet .feather; KITTI, AB3DMOT, MOTChallenge .txt; nuScenes, OpenLABEL .json"
        raise LogError(f"{path}: no form of boxes that fbench knows ({forms})")
    return form


def _recognize_folder(path: Path) -> str | None:
    if (path / "label_2").is_dir():
        return "kitti"
    if (path / "label_02").is_dir():
        return "kitti-tracking"
    if any((path / name).is_file() for name in ("gt/gt.txt", "det/det.txt", "gt.txt", "det.txt")):
        return "mot"
    files = sorted(file for file in path.iterdir() if file.is_file() and file.name not in COMPANIONS)
    if any(file.suffix.lower() in SUFFIXES for file in files):
        return "table"
    numbered = [file for file in files if file.suffix == ".txt" and file.stem.isascii() and file.stem.isdigit()]
    found = (form for file in numbered[:_MAX_INSPECTED] if (form := _recognize_text(file)) is not None)
    return next(found, "kitti" if numbered else None)


def _recognize_file(path: Path) -> str | None:
    suffix = path.suffix.lower()
    if suffix == ".json":
        head = head_of(path)
        return "openlabel" if '"openlabel"' in head else "nuscenes" if '"results"' in head else None
    if suffix in SUFFIXES and not (suffix == ".csv" and _recognize_text(path) in ("mot", "ab3dmot")):
        return "table"
    return _recognize_text(path) if suffix in (".txt", ".csv") else None


def _recognize_text(path: Path) -> str | None:
    """Tell from the first row; a table has a row of names first."""
    first = next((line for line in head_of(path).splitlines() if line.strip()), "").lstrip("\ufeff")
    fields, split = first.split(), first.split(",")
    if len(split) > 5:
        if not all(map(is_number, filter(None, (field.strip() for field in split)))):
            return None
        return "ab3dmot" if len(split) == AB3DMOT_COLUMNS else "mot"
    if len(fields) in (15, 16):
        return "kitti"
    # Frame, id, class ...; some trackers write more behind the score.
    is_row = len(fields) >= 17 and is_number(fields[0]) and not is_number(fields[2])
    return "kitti-tracking" if is_row else None
