"""Suites: their logs, pipelines and conditions, and the cells that they make."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

from fbench.api.suites.file import Place
from fbench.api.suites.logs import Drive
from fbench.replay.data.files import file_name, with_digest
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

RUNS, LOGS = "runs", "logs"
"""Folders of a suite."""


@dataclass(frozen=True)
class SuiteLog:
    """One log of a suite."""

    name: str
    request: LogRequest
    url: str = ""
    """Where it comes from, if not from this machine."""
    drive: Drive | None = None
    """What is to be simulated, if it is."""
    place: Place = field(default=(), compare=False)
    """Where the suite's file names it."""


@dataclass(frozen=True)
class SuitePipeline:
    """One pipeline of a suite, by the name that the suite gives it."""

    name: str
    base: str
    settings: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    detect_every: int | None = None


@dataclass(frozen=True)
class SuiteCell:
    """One log, pipeline, condition, rate and seed."""

    log: str
    pipeline: str
    condition: str
    """With its severity; `clear` for none."""
    rate: str
    seed: int
    request: ReplayRequest


@dataclass(frozen=True)
class Suite:
    """What a suite file asks for."""

    title: str
    logs: Sequence[SuiteLog]
    pipelines: Sequence[SuitePipeline]
    conditions: Mapping[str, str]
    """What a replay takes, by name."""
    rates: Sequence[str]
    seeds: Sequence[int]
    options: ReplayRequest
    """What all cells have in common."""
    profiles: Sequence[str]
    folder: Path
    content: str
    """The file's text."""
    where: str = ""
    urls: Mapping[str, str] = field(default_factory=dict)

    def cells(self) -> list[SuiteCell]:
        """Return all cells, so that those which need the same messages follow each other."""
        return [cell for log in self.logs for cell in self._cells_of(log)]

    def _cells_of(self, log: SuiteLog) -> Iterator[SuiteCell]:
        for (name, text), seed, rate in product(self.conditions.items(), self.seeds, self.rates):
            if not text and seed != self.seeds[0]:
                continue  # nothing random in it
            for pipeline in self.pipelines:
                yield SuiteCell(log.name, pipeline.name, name, rate, seed, self._request(
                    log, pipeline, name, text, rate, seed,
                ))  # fmt: skip

    def _request(
        self, log: SuiteLog, pipeline: SuitePipeline, name: str, text: str, rate: str, seed: int
    ) -> ReplayRequest:
        label = f"{name}{'' if rate == 'max' else f'-x{rate}'}{'' if seed == 0 else f'-seed{seed}'}"
        safe = file_name(label.replace(":", "-"))
        # What two names would share gets a digest of its own.
        safe = safe if re.fullmatch(r"[\w.+:-]+", label) and "_" not in label else with_digest(safe, label)
        return replace(
            self.options, log=log.request, pipeline=pipeline.base, settings=list(pipeline.settings),
            sensors=list(pipeline.sensors), detect_every=pipeline.detect_every, condition=text, rate=rate, seed=seed,
            out=self.folder / RUNS / log.name / pipeline.name / safe,
        )  # fmt: skip
