"""Logs of suites: recorded ones, those from elsewhere, and those that are simulated for them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.api.suites.cells import is_sealed_log, seal_log, was_sealed
from fbench.datasets.importing.run import holds_log, write_recording
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.logs.convert.target import Target

if TYPE_CHECKING:
    from fbench.datasets.city.spec import CitySpec


@dataclass(frozen=True)
class Drive:
    """One simulated log."""

    spec: "CitySpec"
    log: Path

    @property
    def condition(self) -> str:
        """Under which it is recorded."""
        return self.spec.condition.name

    @property
    def scene(self) -> str:
        """What conditions are compared on."""
        return f"{self.spec.world}-{self.spec.seed}"

    @property
    def name(self) -> str:
        """Of its log and of the folder of its runs."""
        return f"{self.spec.world}-{self.condition}-{self.spec.seed}"


def simulate(drives: Sequence[Drive], progress: Callable[[str, int, int], None]) -> Iterator[bool]:
    """Write the logs that aren't there, or aren't whole any more; yields for each whether it was written. Raises
    ConfigError where a log can't be written, or another has its name.
    """
    from fbench.datasets.city.recording import Cities, CityRecording

    cities = Cities()
    for drive in drives:
        drive.log.parent.mkdir(parents=True, exist_ok=True)
        is_there = is_sealed_log(drive.log, drive.spec.log_id)
        if not is_there:
            # Without a seal where a simulation was killed just before it would have written that.
            if drive.log.exists() and not was_sealed(drive.log) and not holds_log(drive.log, drive.spec.log_id):
                raise ConfigError(
                    f"{drive.log}: exists already, and wasn't simulated here; choose another folder with --out"
                )
            recording = CityRecording(drive.spec, drive.name, cities=cities)
            write_recording(recording, Target(drive.log, overwrite=True), progress)
            seal_log(drive.log, drive.spec.log_id)
        yield not is_there
