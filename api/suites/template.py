"""Suite files for given logs, as `fbench bench init` writes them."""

import json
import os
from collections.abc import Sequence
from pathlib import Path

from fbench.api.suites.file import SuiteText
from fbench.api.suites.plan import make_suite
from fbench.api.suites.store import is_url
from fbench.replay.contracts.errors import FbenchError, output_error
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.files import make_parent, replace_text
from fbench.replay.setup.source import LogRequest, log_source

_BY_KIND = {"camera": "camera2d", "lidar": "lidar3d", "radar": "radar3d"}
_TEMPLATE = """# A suite of fbench: every log with every pipeline, condition, rate and seed. Run it: fbench bench {name}
version = 1

# Files, folders, patterns or URLs, relative to this file. To simulate one: [[logs]] with simulate = "urban".
logs = {logs}

# Names, files, or tables: [pipelines.wide] with base = "late3d" and set = ["lidar.cluster.eps_m=0.8"].
pipelines = {pipelines}

# "fog" runs at each of the severities, "fog:3" at that one, and "clear" changes nothing; see fbench plugins conditions.
conditions = {conditions}
severities = [3]

rates = ["max"]  # the pace; it changes no result in lockstep
seeds = [0]  # of the random numbers of conditions

[scoring]
range_m = 50.0  # objects within this distance
in_view = true  # only those that a camera sees
# profiles = ["nuscenes-detection"]  # score by other tools' rules, too
"""


def write_suite(path: Path, logs: Sequence[str], pipelines: Sequence[str], conditions: Sequence[str]) -> int:
    """Write a suite file and return the number of its cells; without pipelines, those that fit the sensors of the first
    log. Raises ConfigError where a log isn't there, or a name isn't known.
    """
    given = [_beside(log, path) for log in logs]
    named = [_beside(name, path) if name.endswith(".toml") else name for name in pipelines] or _fitting(logs[0])
    if conditions and "clear" not in conditions:
        conditions = ["clear", *conditions]
    text = _TEMPLATE.format(
        name=path.name, logs=_list(given), pipelines=_list(named), conditions=_list(conditions or ["clear"])
    )
    suite = make_suite(SuiteText(text.encode(), str(path)), path.parent, Path("runs") / path.stem)
    make_parent(path)
    try:
        replace_text(path, text)
    except OSError as error:
        raise output_error(path, error) from error
    return len(suite.cells())


def _beside(log: str, path: Path) -> str:
    """A path as seen from the suite file."""
    if is_url(log) or Path(log).is_absolute():
        return log
    return os.path.relpath(log, path.parent)


def _fitting(log: str) -> list[str]:
    """Pipelines for the kinds of sensors of a log, and their fusion where there are several."""
    try:
        rig = log_source(LogRequest(Path(log))).open(FaultLog()).rig
    except FbenchError:  # a pattern, or on another machine: then any will do as an example
        return ["lidar3d"]
    found = [name for kind, name in _BY_KIND.items() if any(own == kind for own in rig.kinds.values())]
    return [*(["late3d"] if len(found) > 1 else []), *found] or ["lidar3d"]


def _list(items: Sequence[str]) -> str:
    """A list of texts, whose escapes TOML shares with JSON."""
    return f"[{', '.join(json.dumps(item) for item in items)}]"
