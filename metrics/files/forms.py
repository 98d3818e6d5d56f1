"""Telling which form files or folders of boxes have, and which file is which sequence."""

from collections.abc import Mapping
from pathlib import Path

from fbench.metrics.files.logs import logs_in, open_logs
from fbench.metrics.files.sources import Source, images, submission, tables, texts
from fbench.replay.boxfiles.recognise import recognised
from fbench.replay.boxfiles.table_files import SUFFIXES
from fbench.replay.errors import ConfigError, LogError
from fbench.replay.names import did_you_mean

FORMS = ("table", "kitti", "kitti-tracking", "ab3dmot", "mot", "nuscenes", "log")
_NUSCENES_TABLES = "nuscenes-tables"
_NUSCENES_VERSIONS = ("v1.0-mini", "v1.0-trainval", "v1.0-test")
_INNER = ("data", "label_02", "label_2")
_LOOKED_AT = 20


def open_source(path: Path, form: str | None, is_truth: bool, like: Source | None = None) -> Source:
    """Open a file or folder of boxes; nothing is read yet but what tells names.

    Args:
        path: File or folder.
        form: One of `FORMS`; `None`: names and content tell.
        is_truth: Whether it is truth, in which some forms write other things than in results.
        like: The truth, where these are results: what can't be told is as there.

    Raises:
        ConfigError: where there is no such file or form.
        LogError: where the form can't be told.
    """
    _require_usable(path, form)
    if form in (None, "log") and (logs := logs_in(path)):
        if not is_truth:
            raise ConfigError(f"{path}: a log; score the results in it by fbench replay {path} -p recorded")
        return open_logs(path, logs)
    files = _files(path)
    kind = form or _form(path, files, like)
    if kind == "nuscenes":
        if len(files) > 1:
            raise ConfigError(f"{path}: {len(files)} files; name one submission")
        return submission(next(iter(files.values())), like)
    if kind == "kitti":
        return images(path, files)
    if kind == "table":
        return tables(path, files)
    return texts(path, kind, files, is_truth, is_single=path.is_file() or _is_sequence(path))


def _require_usable(path: Path, form: str | None) -> None:
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder")
    if not (path.is_file() or path.is_dir()):
        raise ConfigError(f"{path}: neither a regular file nor a folder")
    if form == _NUSCENES_TABLES or any((path / version).is_dir() for version in _NUSCENES_VERSIONS):
        raise ConfigError(
            f"{path}: the tables of nuScenes aren't scored as they are; first fbench log import nuscenes {path} -o LOGS"
        )
    if form is not None and form not in FORMS:
        raise ConfigError(f"'{form}' is no form of boxes that can be scored{did_you_mean(form, FORMS)}")
    if form == "log" and not logs_in(path):
        raise LogError(f"{path}: no log of fbench, which is a file .mcap or a folder with log.json")
    if path.is_dir() and (path / "manifest.json").is_file():
        raise ConfigError(f"{path}: a run folder; score it by itself: fbench score {path}")


def _files(path: Path) -> dict[str, Path]:
    """Files by what they are called, in the order of names."""
    if path.is_file():
        return {_sequence_of(path): path}
    if _is_sequence(path):
        return {path.resolve().name: path / "gt" / "gt.txt"}
    # Beside its folder `data` TrackEval puts numbers and plots.
    inner = next((path / name for name in _INNER if (path / name).is_dir()), None)
    if inner is not None:
        return _files(inner)
    folders = {folder.name: folder / "gt" / "gt.txt" for folder in _listed(path) if _is_sequence(folder)}
    own = folders or {file.stem: file for file in _listed(path) if _is_boxes(file)}
    if not own:
        raise LogError(f"{path}: no files of boxes in it (.txt, .csv, .parquet, SEQUENCE/gt/gt.txt)")
    kinds = {file.suffix.lower() == ".txt" for file in own.values()}
    if len(kinds) > 1:
        raise LogError(f"{path}: texts and tables in one folder; put them into two")
    return own


def _listed(path: Path) -> list[Path]:
    try:
        return sorted(path.iterdir())
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def _is_boxes(file: Path) -> bool:
    return file.is_file() and (file.suffix == ".txt" or file.suffix.lower() in SUFFIXES)


def _is_sequence(path: Path) -> bool:
    """Whether a folder is one sequence of MOTChallenge."""
    return path.is_dir() and (path / "gt" / "gt.txt").is_file()


def _sequence_of(file: Path) -> str:
    """`SEQ/gt/gt.txt` is sequence SEQ."""
    is_mot = file.name == "gt.txt" and file.parent.name == "gt"
    return file.resolve().parent.parent.name if is_mot else file.stem


def _form(path: Path, files: Mapping[str, Path], like: Source | None) -> str:
    found: dict[str, Path] = {}
    for file in [file for file in files.values() if _has_content(file)][:_LOOKED_AT]:
        found.setdefault(recognised(file), file)
    if len(found) > 1:
        (one, file), (other, second) = list(found.items())[:2]
        raise LogError(f"{path}: {file.name} is '{one}', but {second.name} is '{other}'; one folder, one form")
    if found:
        return _known(path, next(iter(found)))
    if like is None:
        raise LogError(f"{path}: every file is empty, so its form can't be told; say --truth-format")
    return like.form


def _known(path: Path, form: str) -> str:
    if form not in FORMS:
        raise ConfigError(f"{path}: '{form}' can't be scored yet; there are: {', '.join(FORMS)}")
    return form


def _has_content(file: Path) -> bool:
    try:
        with file.open("rb") as opened:
            return bool(opened.read(4096).strip())
    except OSError as error:
        raise LogError(f"{file}: can't be read ({error.strerror})") from error
