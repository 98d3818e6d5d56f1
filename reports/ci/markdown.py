"""A short comment in Markdown: one table, the worst changes, a picture of the intervals, and links."""

from fbench.replay.data.comparison import Comparison, Row
from fbench.replay.data.scores import DASH

_MOST_ROWS, _MOST_OBJECTS = 15, 8
_WIDTH, _MOST_NAME = 41, 50  # Characters of the picture, and of names before it
_HELP = "https://github.com/fbench/fbench/blob/main/docs/ci.md"
_SIGNS = {"REGRESSED": "❌", "INCONCLUSIVE": "❔", "improved": "✅", "changed": "🔶"}


def comment(comparison: Comparison, link: str = "") -> str:
    """Return the comment; empty where nothing changed. `link`: address of the job, whose files tell more."""
    if comparison.state == "identical":
        return ""
    gating = list(comparison.gating)
    informing = [r for r in comparison.rows if not r.gate and r.verdict in ("REGRESSED", "improved", "changed")]
    rows = [*gating, *informing][:_MOST_ROWS]
    lines = [f"### fbench: {_escape(comparison.headline)}", ""]
    if rows:
        lines += ["| | number | base | head | change | 95 % interval | verdict |", "|---|---|--:|--:|--:|--:|---|"]
        lines += [_line(row) for row in rows]
        if (more := len(gating) + len(informing) - len(rows)) > 0:
            lines += ["", f"{more} more numbers changed; `fbench compare` lists them."]
    lines += ["", *(f"- **failed**: {_escape(failure)}" for failure in comparison.failures)]
    lines += [f"- first difference in {_escape(d.cell)}: {_escape(str(d))}" for d in comparison.divergences[:3]]
    places = comparison.places
    lines += [f"- {_escape(f'{places[c.cell]}{c}')}" for c in comparison.objects[:_MOST_OBJECTS]]
    lines += [f"- worst {_escape(f'{places[w.cell]}{w}')}" for w in comparison.worst[:1]]
    if picture := _picture([row for row in rows if row.low is not None]):
        lines += [
            "",
            "<details><summary>Intervals of the changes</summary>",
            "",
            "```",
            *picture,
            "```",
            "",
            "</details>",
        ]
    job = f"[Report and files of this run]({link}) · " if link else ""
    return "\n".join([*lines, "", f"{job}[How to read this]({_HELP})"]) + "\n"


def _line(row: Row) -> str:
    interval = DASH if row.low is None or row.high is None else f"{row.low:+.3f} to {row.high:+.3f}"
    values = (DASH if value is None else f"{value:.3f}" for value in (row.base, row.head))
    delta = DASH if row.delta is None else f"{row.delta:+.3f}"
    sign = _SIGNS.get(row.verdict, "")
    verdict = f"**{row.verdict}**" if row.gate else f"{row.verdict} (informs)"
    cells = (sign, _escape(row.name), *values, delta, interval, verdict)
    return f"| {' | '.join(cells)} |"


def _picture(rows: list[Row]) -> list[str]:
    """Intervals on one scale, zero in the middle: `[---|--o--]`."""
    most = max((max(abs(row.low or 0.0), abs(row.high or 0.0)) for row in rows), default=0.0)
    if not most:
        return []
    half, several = _WIDTH // 2, len({(row.pipeline, row.condition) for row in rows}) > 1
    names = [f"{r.metric} {r.class_} {r.slice}{f', {r.pipeline} {r.condition}' if several else ''}" for r in rows]
    broad = min(max(map(len, names)), _MOST_NAME)
    lines = []
    for row, name in zip(rows, names, strict=True):
        low, high, at = (half + round(half * (value or 0.0) / most) for value in (row.low, row.high, row.delta))
        marks = ["-" if low <= i <= high else " " for i in range(_WIDTH)]
        marks[half] = "|"
        marks[low], marks[high] = "[", "]"
        marks[min(max(at, 0), _WIDTH - 1)] = "o"
        lines.append(f"{_escape_code(name)[:broad]:{broad}} {''.join(marks)}")
    return [*lines, f"{'':{broad}} {f'{-most:+.3f}':<{half}}0{f'{most:+.3f}':>{half}}"]


def _escape_code(text: str) -> str:
    """Names must not end the block of code that they stand in."""
    return "".join(c if c.isprintable() and c != "`" else " " for c in text)


def _escape(text: str) -> str:
    """Names come from data: they must be neither table nor markup nor mention."""
    plain = "".join(c if c.isprintable() else " " for c in text)
    for character in "\\`*_{}[]<>|":
        plain = plain.replace(character, f"\\{character}")
    return plain.replace("@", "@\u200b").replace("#", "#\u200b")
