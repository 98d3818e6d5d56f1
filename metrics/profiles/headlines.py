"""Which rows of a profile are printed: the others are in the file."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from fbench.replay.scores import Score


@dataclass(frozen=True)
class Headlines:
    """Metrics of a profile that people look for."""

    metrics: tuple[str, ...]
    """In the order in which they are printed."""
    all_matchings: bool = False
    """Whether one metric has rows for several ways of matching, of which each counts; else the first is shown."""
    has_levels: bool = False
    """Whether rows are about levels of difficulty, `all, easy`, and none about all of them."""


_TRACKEVAL = Headlines(
    ("hota", "deta", "assa", "loca", "mota", "motp", "idf1", "idp", "idr", "clr_re", "clr_pr", "clr_tp", "clr_fp",
     "clr_fn", "idsw", "frag", "mt", "pt", "ml")
)  # fmt: skip
_HEADLINES: Mapping[str, Headlines] = {
    "default": Headlines(
        ("f1", "precision", "recall", "ap", "mota", "mota_no_fp", "motp", "idf1", "hota", "deta", "assa", "loca",
         "idsw", "frag", "mt", "ml")
    ),
    "trackeval-kitti": _TRACKEVAL,
    "trackeval-mot": _TRACKEVAL,
    "trackeval-mot15": _TRACKEVAL,
    "trackeval-mot20": _TRACKEVAL,
    "motmetrics": Headlines(
        ("mota", "motp", "idf1", "idp", "idr", "recall", "precision", "num_switches", "num_fragmentations",
         "num_false_positives", "num_misses", "mostly_tracked", "partially_tracked", "mostly_lost")
    ),
    "nuscenes-detection": Headlines(
        ("nds", "map", "mate", "mase", "maoe", "mave", "maae", "mean_dist_ap", "ate", "ase", "aoe", "ave", "aae")
    ),
    "nuscenes-tracking": Headlines(
        ("amota", "amotp", "recall", "motar", "mota", "motp", "mt", "ml", "faf", "tp", "fp", "fn", "ids", "frag",
         "tid", "lgd")
    ),
    "kitti-object": Headlines(("ap", "ap11", "aos"), all_matchings=True, has_levels=True),
    "kitti-3dmot": Headlines(
        ("samota", "amota", "amotp", "mota", "motp", "recall", "precision", "f1", "ids", "frag", "tp", "fp", "fn",
         "mt", "ml", "best_threshold")
    ),
    "coco": Headlines(
        ("ap", "ap50", "ap75", "aps", "apm", "apl", "ar1", "ar10", "ar100", "ars", "arm", "arl"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Line:
    """One line of the table: a metric and how it was matched."""

    metric: str
    matching: str
    scores: Mapping[str, Score]
    """By column: the class, and what of it."""


def headlines_of(profile: str) -> Headlines:
    """Return what to print of a profile; every metric where nobody chose."""
    return _HEADLINES.get(profile, Headlines(()))


def lines(rows: Iterable[Score], profile: str, part: str = "all") -> list[Line]:
    """Return the lines about a part, a column for each class and level, `car, easy`."""
    headlines = headlines_of(profile)
    own = [row for row in rows if row.slice == part or (headlines.has_levels and row.slice.startswith(f"{part}, "))]
    found: dict[tuple[str, str], dict[str, Score]] = {}
    for metric in headlines.metrics or tuple(dict.fromkeys(row.metric for row in own)):
        for row in own:
            if row.metric == metric:
                _add(found, row, part, headlines.all_matchings)
    return [Line(metric, _common(cells.values()), cells) for (metric, _), cells in found.items()]


def by_slice(rows: Iterable[Score]) -> dict[tuple[str, str, str, str], Score]:
    """Return rows by slice, class, metric and matching, so that those of many sequences are found at once."""
    found: dict[tuple[str, str, str, str], Score] = {}
    for row in rows:
        found.setdefault((row.slice, row.class_, row.metric, row.matching), row)
    return found


def _add(found: dict[tuple[str, str], dict[str, Score]], row: Score, part: str, all_matchings: bool) -> None:
    column = row.class_ + row.slice.removeprefix(part)
    kind = row.matching if all_matchings else ""
    found.setdefault((row.metric, kind), {}).setdefault(column, row)


def _common(scores: Iterable[Score]) -> str:
    """How boxes matched, where that is the same for all columns."""
    different = list(dict.fromkeys(score.matching for score in scores))
    return different[0] if len(different) == 1 else ""
