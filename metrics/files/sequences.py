"""Sequences of files: truth beside results, recognized and paired."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from fbench.metrics.files.side import InputWarning, InputWarnings, Side, Where, find_missing_entries, join, nothing
from fbench.metrics.files.sources import Source, open_images, open_submissions, open_tables, open_texts
from fbench.replay.contracts.errors import ConfigError, LogError, MetricError, did_you_mean
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.sequences import Sequence, Space
from fbench.replay.formats.recognition import SUFFIXES, recognize
from fbench.replay.formats.text import MAX_FRAMES, frame_number, lines
from fbench.replay.logs.container import LOG_JSON

FORMS = ("table", "kitti", "kitti-tracking", "ab3dmot", "mot", "nuscenes", "log")
_NUSCENES_TABLES = "nuscenes-tables"
_NUSCENES_VERSIONS = ("v1.0-mini", "v1.0-trainval", "v1.0-test")
_INNER = ("data", "label_02", "label_2")
_OF_SEQUENCE = ("gt/gt.txt", "annotations.feather")
"""Files in a folder that is called as its sequence, of MOTChallenge and of Argoverse 2."""
_MAX_INSPECTED = 20
_LOG_SUFFIX = ".mcap"
_NUM_SEQMAP = 4  # Columns: name, `empty`, first frame, number of frames (`evaluate_tracking.seqmap.training`)
Missing = Literal["error", "empty"]
MISSING: tuple[Missing, ...] = get_args(Missing)
_MAX_NAMED = 5


def open_source(path: Path, form: str | None, is_truth: bool, like: Source | None = None) -> Source:
    """Open a file or folder of boxes; nothing is read yet but what tells names. `form` is one of `FORMS`; `None`: names
    and content tell. Some forms write other things in truth than in results. `like` is the truth, where these are
    results: what can't be told is as there. Raises ConfigError where there is no such file or form, LogError where the
    form can't be told.
    """
    _require_usable(path, form)
    if form in (None, "log") and (logs := _logs_in(path)):
        if not is_truth:
            raise ConfigError(f"{path}: a log; score the results in it by fbench replay {path} -p recorded")
        from fbench.metrics.files.logs import open_logs  # logs take a while to import

        return open_logs(path, logs)
    files = _files(path)
    kind = form or _form(path, files, like)
    if kind == "nuscenes":
        if len(files) > 1:
            raise ConfigError(f"{path}: {len(files)} files; name one submission")
        return open_submissions(next(iter(files.values())), like)
    if kind == "kitti":
        return open_images(path, files)
    if kind == "table":
        return open_tables(path, files)
    return open_texts(path, kind, files, is_truth, is_single=path.is_file() or _in_sequence(path) is not None)


def _is_log(path: Path) -> bool:
    """Tell whether a path is a log of fbench, by its name."""
    return (path.is_file() and path.suffix == _LOG_SUFFIX) or (path / LOG_JSON).is_file()


def _logs_in(path: Path) -> list[Path]:
    """Return the logs that a path is or, as a folder, holds; none where it is something else."""
    if _is_log(path):
        return [path]
    return [own for own in sorted(path.iterdir()) if _is_log(own)] if path.is_dir() else []


def _require_usable(path: Path, form: str | None) -> None:
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder")
    if not (path.is_file() or path.is_dir()):
        raise ConfigError(f"{path}: neither a regular file nor a folder")
    if form == _NUSCENES_TABLES or any((path / version).is_dir() for version in _NUSCENES_VERSIONS):
        advice = f"first fbench log import nuscenes {path} -o LOGS"
        raise ConfigError(f"{path}: the tables of nuScenes aren't scored as they are; {advice}")
    if form is not None and form not in FORMS:
        raise ConfigError(f"'{form}' is no form of boxes that can be scored{did_you_mean(form, FORMS)}")
    if form == "log" and not _logs_in(path):
        raise LogError(f"{path}: no log of fbench, which is a file .mcap or a folder with log.json")
    if path.is_dir() and (path / "manifest.json").is_file():
        raise ConfigError(f"{path}: a run folder; score it by itself: fbench score {path}")


def _files(path: Path) -> dict[str, Path]:
    """Files by what they are called, in the order of names."""
    if path.is_file():
        whole = path.resolve()
        called = (parent.name for parent in whole.parents[:2] if _in_sequence(parent) == whole)
        return {next(called, path.stem): path}
    if (only := _in_sequence(path)) is not None:
        return {path.resolve().name: only}
    # Beside its folder `data` TrackEval puts numbers and plots.
    inner = next((path / name for name in _INNER if (path / name).is_dir()), None)
    if inner is not None:
        return _files(inner)
    try:
        entries = sorted(path.iterdir())
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error
    own = {folder.name: file for folder in entries if (file := _in_sequence(folder)) is not None} or {
        file.stem: file
        for file in entries
        if file.is_file() and (file.suffix == ".txt" or file.suffix.lower() in SUFFIXES)
    }
    if not own:
        raise LogError(f"{path}: no files of boxes in it (.txt, .csv, .parquet, .feather, SEQUENCE/gt/gt.txt)")
    if len({file.suffix.lower() == ".txt" for file in own.values()}) > 1:
        raise LogError(f"{path}: texts and tables in one folder; put them into two")
    return own


def _in_sequence(folder: Path) -> Path | None:
    """The file of a folder that is one sequence."""
    files = (folder / name for name in _OF_SEQUENCE)
    return next((file for file in files if file.is_file()), None) if folder.is_dir() else None


def _form(path: Path, files: Mapping[str, Path], like: Source | None) -> str:
    found: dict[str, Path] = {}
    num = 0
    for file in files.values():
        try:
            with file.open("rb") as opened:
                is_empty = not opened.read(4096).strip()
        except OSError as error:
            raise LogError(f"{file}: can't be read ({error.strerror})") from error
        if not is_empty and num < _MAX_INSPECTED:
            num += 1
            found.setdefault(recognize(file), file)
    if not found:
        if like is None:
            raise LogError(f"{path}: every file is empty, so its form can't be told; say --truth-format")
        return like.form
    (form, file), *others = found.items()
    for other, second in others:
        raise LogError(f"{path}: {file.name} is '{form}', but {second.name} is '{other}'; one folder, one form")
    if form not in FORMS:
        raise ConfigError(f"{path}: '{form}' can't be scored yet; there are: {', '.join(FORMS)}")
    return form


def _read_seqmap(path: Path) -> dict[str, int | None]:
    """Frames of each listed sequence; `None` where the list has names only, as MOTChallenge's."""
    if not path.is_file():
        raise ConfigError(f"--seqmap {path}: no such file")
    found: dict[str, int | None] = {}
    for line in lines(path):
        name, num = line.fields[0], len(line.fields)
        if num not in (1, _NUM_SEQMAP):
            raise LogError(f"{line.where}: {num} columns, expected a name, or: NAME empty 000000 FRAMES")
        if name in found:
            raise LogError(f"{line.where}: sequence '{name[:40]}' twice")
        if num > 1 or line.number > 1 or name != "name":
            found[name] = min(frame_number(line.fields[3], line.where), MAX_FRAMES) if num == _NUM_SEQMAP else None
    if not found:
        raise LogError(f"{path}: lists no sequence")
    return found


@dataclass(frozen=True)
class Choice:
    """What of the files is scored."""

    sequences: tuple[str, ...] = ()  # Empty: all of the truth
    seqmap: Path | None = None  # A list of sequences with their lengths; others aren't scored
    missing: Missing = "error"  # What a sequence without results is


@dataclass(frozen=True)
class Pair:
    """One sequence in both."""

    truth: str  # As the truth calls it, which is its name
    estimates: str | None  # As the results call it; `None`: there are none
    num_frames: int | None  # As the seqmap says


def _pair(truth: Source, estimates: Source, choice: Choice) -> tuple[list[Pair], list[str]]:
    """Match sequences by their names, and say what there is about the rest; two files that are one sequence each belong
    together whatever their names are. A sequence without results is refused unless that counts as misses.
    """
    lengths = {} if choice.seqmap is None else _read_seqmap(choice.seqmap)
    are_single = truth.is_single and estimates.is_single and not lengths
    everything = truth.names if are_single else tuple(lengths or dict.fromkeys([*truth.names, *estimates.names]))
    for name in choice.sequences:
        if name not in everything:
            raise ConfigError(f"--sequences {name}: no such sequence{did_you_mean(name, everything)}")
    if are_single:
        return [Pair(truth.names[0], estimates.names[0], None)], []
    wanted = [name for name in everything if not choice.sequences or name in choice.sequences]
    scored = [name for name in wanted if name in truth.names]
    without = [name for name in wanted if name not in truth.names]
    if not scored:
        where = "the seqmap" if lengths else estimates.path
        raise MetricError(f"{truth.path}: no truth for any sequence of {where}", "GT001")
    notes = [f"no truth for {_list_names(without)}: left out [GT001]"] if without else []
    absent = [name for name in scored if name not in estimates.names]
    if absent and choice.missing == "error":
        advice = "add an empty file, or count them as misses with --missing empty"
        raise MetricError(f"{estimates.path}: no results for {_list_names(absent)}; {advice}")
    notes += [f"no results for {_list_names(absent)}: all of its truth is missed"] if absent else []
    return [Pair(name, None if name in absent else name, lengths.get(name)) for name in scored], notes


def _list_names(names: list[str]) -> str:
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return f"{'sequence' if len(names) == 1 else f'{len(names)} sequences:'} {', '.join(names[:_MAX_NAMED])}{more}"


@dataclass(frozen=True)
class FilePair:
    """Truth and results in files, of which nothing is read yet but names."""

    truth: Source
    estimates: Source
    pairs: tuple[Pair, ...]
    notes: tuple[str, ...]  # What there is to say about sequences that aren't in pairs
    faults: FaultLog = field(default_factory=FaultLog)  # Counts boxes that aren't finite, as sequences are read
    warnings: InputWarnings = field(default_factory=InputWarnings)  # What is odd about results that were read

    def sequences(self, space: Space = "both") -> Iterator[Sequence]:
        """Read sequences in the order of the truth; one is held at a time. Boxes without size elsewhere than in
        `space`, where they are compared, are no fault. Raises LogError naming file, row and column of what can't be
        read, MetricError where truth and results don't fit together.
        """
        for pair in self.pairs:
            truth = self.truth.read(pair.truth)
            absent = Side(nothing(), has_stamps=truth.has_stamps, first_pixel=truth.first_pixel)
            estimates = absent if pair.estimates is None else self.estimates.read(pair.estimates)
            self.warnings.add(*estimates.warnings, find_missing_entries(truth, estimates, pair.truth))
            where = Where(pair.truth, self.truth.path, self.estimates.path)
            yield join(truth, estimates, pair.num_frames, where, self.faults, space)


_ALL = Choice()


def open_files(
    truth: Path,
    estimates: Path,
    choice: Choice = _ALL,
    truth_form: str | None = None,
    estimates_form: str | None = None,
) -> FilePair:
    """Open truth and results, each a file or folder. Forms are of `FORMS`; `None`: names and content tell. Raises
    ConfigError where there is no such file, form or sequence, LogError where a form can't be told, MetricError where no
    sequence has truth, or one has no results.
    """
    true = open_source(truth, truth_form, is_truth=True)
    own = open_source(estimates, estimates_form, is_truth=False, like=true)
    pairs, notes = _pair(true, own, choice)
    pair = FilePair(true, own, tuple(pairs), tuple(notes), true.faults)
    submission = own.submission()
    if submission is not None and not submission.has_meta:
        pair.warnings.add(InputWarning("submission without 'meta', which nuscenes-devkit refuses", 1))
    return pair
