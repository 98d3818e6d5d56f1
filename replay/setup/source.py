"""A log as the command line names it: the file, and everything that is said about it."""

import inspect
import sys
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.rig import LogSpan
from fbench.replay.engine.frame_buffer import SyncParams, make_sync_params
from fbench.replay.formats.rig_files import open_rig_file
from fbench.replay.formats.text import digest_of
from fbench.replay.logs.codecs.plugin import NamedDecoder
from fbench.replay.logs.open import open_log, read_log_times, span_ns
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.setup import BoxSource, Setup, StampParams, make_stamp_params
from fbench.replay.runs.manifest import InputEntry, TruthEntry
from fbench.replay.setup.configuration import Config, FramesTable, find_config, inside, load_config, setup_of

NO_CONFIG = "none"


@dataclass(frozen=True)
class LogRequest:
    """A log and what the user says about it; travels as JSON."""

    path: Path
    config: str | None = None
    """File; `none`: without one, even where the log has one beside it; `None`: that one, if there is one."""
    rig: Sequence[Path] = ()
    """Files with calibration; the first one that names a sensor counts."""
    truth: BoxSource | None = None
    detections: BoxSource | None = None
    """Results of another system."""
    topics: Sequence[str] = ()
    """Patterns of those that are read."""
    decoder: Sequence[str] = ()
    """Decoders of messages that fbench doesn't know: names (see `fbench plugins decoders`) or `FILE.py:FUNCTION`."""

    def absolute(self) -> "LogRequest":
        """Return the same with paths that hold in every folder."""
        from fbench.replay.contracts.entry_points import absolute_name  # plug-ins need tables

        config = self.config if self.config in (None, NO_CONFIG) else str(Path(self.config).resolve())
        path, rig = self.path.resolve(), [path.resolve() for path in self.rig]
        boxes = (self.truth, self.detections)
        truth, detections = (source and replace(source, path=source.path.resolve()) for source in boxes)
        decoder = [absolute_name(name) for name in self.decoder]
        return replace(self, path=path, config=config, rig=rig, truth=truth, detections=detections, decoder=decoder)


@dataclass(frozen=True, eq=False)
class LogSource:
    """A log that can be opened, repeatedly."""

    path: Path
    setup: Setup = field(default_factory=Setup)
    frames: FramesTable = field(default_factory=FramesTable)
    offsets_ms: Mapping[str, float] = field(default_factory=dict)
    topics: Sequence[str] = ()
    inputs: Sequence[InputEntry] = ()  # Files beside the log that matter

    def open(self, faults: FaultLog) -> LogReader:
        """Open the log; see `open_log`."""
        return open_log(self.path, faults, self.topics, self.setup)

    def span(self) -> LogSpan:
        """When messages were recorded: the first, the last, and how often those of each sensor."""
        log = self.open(FaultLog())
        times = log.container.log_times() or read_log_times(log.container)
        found = span_ns(log.container, times) or (0, 0)
        gaps = {
            role.sensor: np.diff(times[id_]) for id_, role in sorted(log.roles.items()) if len(times.get(id_, ())) > 1
        }
        return LogSpan(*found, {name: int(np.median(gap)) for name, gap in gaps.items()})

    def input_entries(self) -> list[InputEntry]:
        """Files that decide what a run holds, but truth, for its manifest. Raises ConfigError for no such file of
        results, LogError for an unknown form.
        """
        results = self.setup.results
        if results is None:
            return list(self.inputs)
        from fbench.replay.formats.open import results_entry  # tables need pyarrow, most logs no table

        return [*self.inputs, results_entry(results)]

    def truth_entry(self) -> TruthEntry | None:
        """Where truth comes from, if not the log. Raises ConfigError for no such file, LogError for an unknown form."""
        if self.setup.truth is None:
            return None
        from fbench.replay.formats.open import truth_entry  # tables need pyarrow, most logs no table

        return truth_entry(self.setup.truth)

    def sync_params(
        self, reference: str | None, timeout_ms: float | None, tolerance_ms: float | None, max_gap_s: float | None
    ) -> SyncParams:
        """How messages become frames, by command line, else configuration. Raises ConfigError for a bad duration."""
        own = self.frames
        return make_sync_params(
            own.reference if reference is None else reference,
            own.timeout_ms if timeout_ms is None else timeout_ms,
            own.tolerance_ms if tolerance_ms is None else tolerance_ms,
            own.max_gap_s if max_gap_s is None else max_gap_s,
        )

    def stamps(self, source: str | None, offsets: Sequence[str]) -> StampParams:
        """Which stamps count: as the command line says, else as the configuration does. Raises ConfigError where one
        can't be understood, or a sensor has two offsets.
        """
        given = make_stamp_params(source or self.frames.stamps, offsets)
        own = {name: round(ms * 1e6) for name, ms in self.offsets_ms.items() if ms and name not in given.offsets_ns}
        both = dict(sorted({**own, **given.offsets_ns}.items()))
        return replace(given, offsets_ns=both, assumed=tuple(sorted(own)))


def log_source(request: LogRequest) -> LogSource:
    """Read the configuration, calibration and decoders of a log. Raises ConfigError where one of the files can't be
    used, or a configuration that nobody named wants to run code.
    """
    path = find_config(request.path) if request.config is None else Path(request.config)
    if request.config == NO_CONFIG:
        path = None
    config, setup, inputs = Config(version=1), Setup(), list[InputEntry]()
    if path is not None:
        config = load_config(path)
        setup = setup_of(config, path)
        rigs = [("rig", path.parent / name) for name in config.body.rig]
        inputs = [_input_entry(role, file) for role, file in (("config", path), *rigs)]
    patch = setup.rig
    for file in reversed(request.rig):
        patch = open_rig_file(file).over(patch)
        inputs.append(_input_entry("rig", file))
    decoders = [name_decoder(name, is_required=True) for name in request.decoder]
    if path is not None and config.decoder:
        decoders += _load_decoders(config, path, request)
    inputs += [_decoder_entry(named) for named in decoders]
    setup = replace(
        setup,
        decoders=tuple(decoders),
        rig=patch,
        truth=request.truth or setup.truth,
        results=request.detections or setup.results,
    )
    offsets = {name: table.offset_ms for name, table in config.sensors.items()}
    return LogSource(request.path, setup, config.frames, offsets, request.topics, inputs)


def name_decoder(name: str, *, is_required: bool = False) -> NamedDecoder:
    """Load a decoder. Raises ConfigError where it can't be loaded, or isn't one."""
    from fbench.replay.contracts.decoders import load_decoder  # plug-ins need tables, most logs no decoder

    path, _, function = name.rpartition(":")
    with redirect_stdout(sys.stderr):  # what its file prints mustn't get between the lines of --json
        decoder = load_decoder(name)
    return NamedDecoder(f"{Path(path).name}:{function}" if path else name, decoder, is_required)


def _load_decoders(config: Config, path: Path, request: LogRequest) -> list[NamedDecoder]:
    """Decoders that a configuration names and the command line doesn't. A file that lies beside a log by chance may be
    anybody's, so that the user must name it, or the configuration.
    """
    from fbench.replay.contracts.entry_points import absolute_name

    named = {absolute_name(name) for name in request.decoder}
    found: list[NamedDecoder] = []
    for name in config.decoder:
        file, _, function = name.rpartition(":")
        full = absolute_name(f"{inside(path, file)}:{function}") if ".py:" in name else name
        if full in named:
            continue
        if full != name and request.config is None:
            what = f"'{name}' is a program, which only runs where you name it"
            raise ConfigError(f"{path}: decoder: {what}; give --config {path}, or --decoder {full}", "SEC002")
        found.append(name_decoder(full))
    return found


def _decoder_entry(named: NamedDecoder) -> InputEntry:
    """The file with a decoder's code, and of an installed one its package's version."""
    from fbench.replay.contracts.entry_points import version_of

    function = inspect.unwrap(named.decoder.function)
    try:
        digest = digest_of(Path(inspect.getfile(function)))
    except TypeError:  # it isn't written in Python
        digest = ""
    return InputEntry(role="decoder", name=f"{named.name}{version_of('decoders', named.name)}", digest=digest)


def _input_entry(role: str, path: Path) -> InputEntry:
    """A file that was used, without where it lies. Raises LogError where it can't be read."""
    return InputEntry(role=role, name=path.name, digest=digest_of(path))


def classes_of(config: str | None) -> Mapping[str, str]:
    """Return the classes that a configuration names, none without one. Raises ConfigError where it can't be used."""
    return {} if config in (None, NO_CONFIG) else load_config(Path(config)).classes
