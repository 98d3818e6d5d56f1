"""Comparisons in the forms that CI servers and dashboards read."""

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path

from fbench.replay.contracts.errors import ConfigError, did_you_mean, output_error
from fbench.replay.data.comparison import Comparison
from fbench.replay.data.files import replace_text
from fbench.reports.ci.jobs import annotations, metrics_report
from fbench.reports.ci.junit import junit
from fbench.reports.ci.markdown import comment
from fbench.reports.ci.trends import benchmark_json, metric_format


def _json(comparison: Comparison) -> str:
    return json.dumps(comparison.content(), indent=1, allow_nan=False) + "\n"


FORMATS: Mapping[str, Callable[[Comparison], str]] = {
    "junit": junit, "markdown": comment, "github": comment, "gitlab": metrics_report, "bmf": metric_format,
    "benchmark-json": benchmark_json, "json": _json,
}  # fmt: skip


def parse_target(text: str) -> tuple[str, Path]:
    """Read `FORMAT=FILE`. Raises ConfigError where it isn't that, or there is no such format."""
    kind, equals, name = text.partition("=")
    if not equals or not name:
        raise ConfigError(f"--write {text}: expected FORMAT=FILE, such as junit=gate.xml")
    if kind not in FORMATS:
        raise ConfigError(f"--write {text}: unknown format '{kind}'{did_you_mean(kind, FORMATS)}")
    if Path(name).is_dir():
        raise ConfigError(f"--write {text}: is a folder; name a file in it")
    return kind, Path(name)


def check_link(text: str) -> str:
    """Return an address as it stands in a comment. Raises ConfigError where it isn't a plain one."""
    if not re.fullmatch(r"https?://[\w.:\[\]-]+(/[\w.~%!$&*+,;=:@/?#-]*)?", text, re.ASCII):
        raise ConfigError(f"--link {text[:200]!r}: expected an address such as https://ci.example.org/jobs/17")
    return text


def write_comparison(comparison: Comparison, kind: str, path: Path, link: str = "") -> list[str]:
    """Write a comparison to a file; return lines for the terminal of the job. Comments lead to `link`, if there is one.

    A comment (`markdown`) is written only where something changed; an older one is removed then. The step summary of
    `github` is appended, as the runner wants it. Raises ConfigError where the file can't be written.
    """
    text = comment(comparison, link) if FORMATS[kind] is comment else FORMATS[kind](comparison)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if kind == "github":
            with path.open("a", encoding="utf-8") as file:
                file.write(text or f"{comparison.headline}\n")
        elif kind == "markdown" and not text:
            path.unlink(missing_ok=True)
        else:
            replace_text(path, text)
    except OSError as error:
        raise output_error(path, error) from error
    return annotations(comparison) if kind == "github" else []
