"""The request of `fbench score`, and which options go together."""

import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.contracts.errors import ConfigError

if TYPE_CHECKING:
    from fbench.metrics.core.bootstrap import Bootstrap

_OF_FILES = {
    "detections": "--detections", "detections_format": "--detections-format", "sequences": "--sequences",
    "seqmap": "--seqmap", "missing": "--missing",
}  # fmt: skip
_OF_PROFILES = {"match": "--match"}
_OF_RUNS = {
    "range_m": "--range-m", "in_view": "--in-view", "distance_m": "--distance-m", "iou": "--iou", "region": "--region",
    "seen": "--seen",
}  # fmt: skip
_OF_OTHER_TRUTH = {
    "config": "--config", "truth_frame": "--truth-frame", "interpolate_truth": "--interpolate-truth",
}  # fmt: skip
_TRUTH = {"truth": "--truth", "truth_format": "--truth-format", **_OF_OTHER_TRUTH}
_COVERAGE = {"min_coverage": "--min-coverage"}
_EXPLAIN = {"explain": "--explain"}
FEWEST, MOST = 20, 100_000
"""Resamples: of fewer the ends of 95 % are extremes of a handful; more take hours and memory and say nothing new."""
_USUAL = 100
_INSTEAD = {"distance_m": "; use --match bev:M", "iou": "; use --match iou2d:SHARE"}


@dataclass(frozen=True)
class Resampling:
    """Whether numbers get confidence intervals."""

    num: int
    seed: int

    def __post_init__(self) -> None:
        if self.num and not FEWEST <= self.num <= MOST:
            raise ConfigError(f"--intervals {self.num}: expected {FEWEST} to {MOST}, such as 1000")

    @property
    def is_rough(self) -> bool:
        """Whether so few resamples tell the ends only roughly."""
        return 0 < self.num < _USUAL

    def how(self) -> "Bootstrap | None":
        """Return how resamples are drawn; `None`: no intervals."""
        if not self.num:
            return None
        from fbench.metrics.core.bootstrap import Bootstrap

        return Bootstrap(self.seed, self.num)


@dataclass(frozen=True)
class ProfileWish:
    """How to count, and where to put it."""

    profile: str
    match: str | None
    classes: tuple[str, ...]
    out: Path | None
    as_json: bool
    resampling: Resampling

    def __post_init__(self) -> None:
        if not self.profile:
            raise ConfigError("--profile: names no profile; see fbench plugins profiles")
        if self.out is not None:
            _require_writable(self.out)

    def only_class(self, default: str) -> str:
        """Return the one class that was asked for.

        Raises:
            ConfigError: where there are several.
        """
        if len(self.classes) > 1:
            raise ConfigError(f"--explain is about one class, not {len(self.classes)}: {', '.join(self.classes)}")
        return self.classes[0] if self.classes else default


def _require_writable(path: Path) -> None:
    """Refuse what no file can be written to before anything is computed.

    Raises:
        ConfigError: naming the path as the user did.
    """
    if path.is_dir():
        raise ConfigError(f"-o {path}: is a folder; name a file in it")
    if not path.parent.is_dir():
        raise ConfigError(f"-o {path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise ConfigError(f"-o {path}: the folder {path.parent} can't be written to")


def require_fitting(given: Collection[str], num_runs: int) -> None:
    """Refuse options that would do nothing.

    Args:
        given: Names of the parameters that the user gave.
        num_runs: How many run folders.

    Raises:
        ConfigError: naming the first such option.
    """
    if "seed" in given and "intervals" not in given:
        raise ConfigError("--seed is of the resamples that --intervals N asks for, which is missing")
    if not num_runs:
        _require_files(given)
        _refuse(given, {**_OF_RUNS, **_OF_OTHER_TRUTH, **_COVERAGE, **_EXPLAIN}, "is for run folders")
        return
    if "detections" in given:
        raise ConfigError("--detections are scored without a RUN: leave out one of them")
    _refuse(given, _OF_FILES, "goes with --truth and --detections, without a RUN")
    if num_runs > 1:
        _refuse(given, {**_TRUTH, **_COVERAGE, **_EXPLAIN}, f"is for one RUN, not {num_runs}")
    if "profile" in given:
        _require_plain(given)
    elif "explain" in given:
        others = {**_TRUTH, **_OF_PROFILES, **_COVERAGE, "intervals": "--intervals", "out": "--out"}
        _refuse(given, others, "doesn't go with --explain")
    else:
        _refuse(given, {**_OF_PROFILES, "class_": "--class"}, "goes with --profile")
        if num_runs == 1:
            _refuse(given, {"out": "--out"}, "goes with --profile or several RUNs; a RUN has its own scores.json")


def _require_plain(given: Collection[str]) -> None:
    """Refuse what a profile leaves no room for."""
    if "truth" in given:
        raise ConfigError("--profile takes the truth that the run has; give it other truth first: fbench score RUN "
                          "--truth PATH")  # fmt: skip
    _refuse(given, {**_OF_RUNS, **_TRUTH, **_EXPLAIN}, "doesn't go with --profile")


def _require_files(given: Collection[str]) -> None:
    missing = [f"--{name}" for name in ("truth", "detections") if name not in given]
    if len(missing) == 2:
        raise ConfigError("what is to be scored? give a RUN folder, or --truth PATH and --detections PATH")
    if missing:
        raise ConfigError(f"{missing[0]} PATH is missing: results in files are scored against truth in files")


def _refuse(given: Collection[str], options: dict[str, str], why: str) -> None:
    for name, option in options.items():
        if name in given:
            raise ConfigError(f"{option} {why}{_INSTEAD.get(name, '')}")
