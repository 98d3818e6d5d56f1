"""Ablation of a suite: each pipeline again without each of its sensors."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from fbench.api.suites.suite import Suite, SuiteLog, SuitePipeline
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import pipeline_parameters
from fbench.replay.contracts.sensor_settings import choose_sensors, make_sensors
from fbench.replay.contracts.variants import sensors_of
from fbench.replay.data.files import file_name
from fbench.replay.data.rig import KINDS
from fbench.replay.setup.source import log_source


@dataclass(frozen=True)
class Ablation:
    """A pipeline, and the same without one sensor."""

    whole: str
    part: str
    sensor: str


def leave_out_sensors(suite: Suite) -> tuple[Suite, list[Ablation]]:
    """Return a suite with each pipeline without each of the sensors that it may use, too, and what belongs together. A
    pipeline of a single sensor has nothing to leave out. Raises ConfigError where a name is taken already. Raises
    LogError where a log can't be used.
    """
    kinds: dict[str, str] = {}
    for log in suite.logs:
        kinds |= _kinds(log)
    pipelines, found = list(suite.pipelines), list[Ablation]()
    for pipeline in suite.pipelines:
        sensors = list(_sensors_of(pipeline, kinds))
        for sensor in sensors if len(sensors) > 1 else []:
            name = f"{pipeline.name}-without-{file_name(sensor)}"
            if any(other.name == name for other in pipelines):
                raise ConfigError(f"--leave-one-out: a pipeline is called '{name}' already")
            given = make_sensors(sensors_of(pipeline.base, pipeline.sensors))
            pipelines.append(replace(pipeline, name=name, sensors=(*(given or ["*"]), f"!{sensor}")))
            found.append(Ablation(pipeline.name, name, sensor))
    return replace(suite, pipelines=pipelines), found


def _kinds(log: SuiteLog) -> dict[str, str]:
    """Kinds of a log's sensors, by name."""
    rig = log_source(log.request).open(FaultLog()).rig
    return {name: rig.kinds[name] for name in rig.sensors(*KINDS.values())}


def _sensors_of(pipeline: SuitePipeline, kinds: dict[str, str]) -> Iterator[str]:
    """Sensors of the kinds that a pipeline has parameters of; all, where it has none of any kind."""
    parameters = pipeline_parameters(pipeline.base, list(pipeline.settings))
    used = {kind for kind in KINDS.values() if any(name.startswith(f"{kind}.") for name in parameters)}
    patterns = make_sensors(sensors_of(pipeline.base, pipeline.sensors))
    names = choose_sensors(kinds, patterns)
    yield from (name for name in names if not used or kinds[name] in used)
