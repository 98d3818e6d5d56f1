"""Annotations of GitHub, and GitLab's report of metrics."""

import re

from fbench.replay.data.comparison import Comparison


def annotations(comparison: Comparison) -> list[str]:
    """Return workflow commands of GitHub: an error for each failure, a warning for each number that needs more data."""
    lines = [_command("error", "fbench budget", failure) for failure in comparison.failures]
    for row in comparison.gating:
        said = f"{row.name}: {row.values}; {row.reason}"
        if row.verdict == "REGRESSED":
            lines.append(_command("error", f"fbench: {row.metric} REGRESSED", said))
        elif row.verdict == "INCONCLUSIVE":
            lines.append(_command("warning", f"fbench: {row.metric} INCONCLUSIVE", said))
    if comparison.is_worse:
        lines += [_command("notice", "fbench", f"{comparison.places[c.cell]}{c}") for c in comparison.objects[:5]]
    return lines


def _command(kind: str, title: str, text: str) -> str:
    """A workflow command, of which text from data is only text: no line break, which would begin another one."""
    plain = "".join(c if c.isprintable() else " " for c in text).replace("%", "%25")
    return f"::{kind} title={title.replace(',', '%2C').replace(':', '%3A')}::{plain}"


def metrics_report(comparison: Comparison) -> str:
    """Return GitLab's `metrics` report (OpenMetrics): merge requests show which numbers changed."""
    lines = []
    for row in comparison.rows:
        if row.head is not None:
            labels = {"pipeline": row.pipeline, "condition": row.condition, "class": row.class_, "slice": row.slice,
                      "matching": row.matching}  # fmt: skip
            text = ",".join(f'{name}="{_quote(value)}"' for name, value in labels.items())
            lines.append(f"fbench_{re.sub(r'[^a-zA-Z0-9_]', '_', row.metric)}{{{text}}} {row.head!r}")
    return "\n".join([*lines, "# EOF"]) + "\n"


def _quote(text: str) -> str:
    plain = "".join(c if c.isprintable() else " " for c in text)
    return plain.replace("\\", "\\\\").replace('"', '\\"')
