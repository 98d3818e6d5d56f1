"""Cards of what only nuScenes' and AB3DMOT's tracking benchmarks count."""

from fbench.metrics.cards.card import CAESAR, SHARE, WENG, Better, MetricCard, Source

_NO_TRUTH = "there is no truth of the class"
_RECALLS = "n recalls r: 40 from 0.1 to 1 in nuscenes-devkit, 1/40 to 1 in AB3DMOT"

OVER_RECALLS = (
    MetricCard(
        "amota", "MOTA averaged over recalls, so that no score threshold must be chosen.",
        f"mean over {_RECALLS}, of MOTAR_r = max(0, 1 - (IDS + FP + FN - (1 - r) P) / (r P))", SHARE, "higher",
        _NO_TRUTH, CAESAR,
        by_profile={"kitti-3dmot": "Of MOTA, neither scaled nor clipped (Weng et al. 2020)."},
    ),
    MetricCard(
        "amotp", "MOTP averaged over recalls.", f"mean over {_RECALLS}, of MOTP", "from 0 up", "lower", _NO_TRUTH,
        CAESAR, "m", by_profile={"kitti-3dmot": "Mean overlap: higher is better (Weng et al. 2020)."},
    ),
    MetricCard(
        "samota", "MOTA, scaled by recall, averaged over recalls.",
        "mean over r = 1/40 ... 1 of min(1, max(0, 1 - (FN + FP + IDS - (1 - r) P) / (r P)))", SHARE, "higher",
        _NO_TRUTH, WENG,
    ),
    MetricCard(
        "motar", "MOTA scaled by recall, at the score with the best MOTA.",
        "max(0, 1 - (IDS + FP + FN - (1 - r) P) / (r P))", SHARE, "higher", _NO_TRUTH, CAESAR,
    ),
    MetricCard("faf", "False alarms in 100 samples, at the score with the best MOTA.", "100 FP / samples", "from 0 up",
               "lower", _NO_TRUTH, CAESAR),
    MetricCard("tid", "How long it takes until a truth track is first found.", "mean over tracks", "from 0 up", "lower",
               _NO_TRUTH, CAESAR, "s"),
    MetricCard("lgd", "Longest gap of a truth track.", "mean over tracks", "from 0 up", "lower", _NO_TRUTH, CAESAR,
               "s"),
    MetricCard("far", "False alarms a frame, at the score with the best MOTA.", "FP / frames", "from 0 up", "lower",
               _NO_TRUTH, WENG),
    MetricCard("best_threshold", "The score with the best MOTA.", "argmax over scores of MOTA", "any score", "neither",
               _NO_TRUTH, WENG),
)  # fmt: skip


def _count(name: str, meaning: str, source: Source, better: Better = "lower") -> MetricCard:
    return MetricCard(name, meaning, "a count", "from 0 up", better, _NO_TRUTH, source, is_count=True)


COUNTS = (
    _count("tp", "Matches, at the score with the best MOTA.", CAESAR, "higher"),
    _count("fp", "Results without a match, at the score with the best MOTA.", CAESAR),
    _count("fn", "Truth boxes without a match, at the score with the best MOTA.", CAESAR),
    _count("gt", "Truth boxes; over classes their mean.", CAESAR, "neither"),
    _count("itp", "Matches with truth that is ignored.", WENG, "neither"),
    _count("ifn", "Ignored truth boxes without a match.", WENG, "neither"),
    _count("gt_objects", "Truth boxes that are matched, ignored ones too.", WENG, "neither"),
    _count("ignored_gt_objects", "Of these, those that are ignored.", WENG, "neither"),
    _count("gt_tracks", "Truth tracks.", WENG, "neither"),
    _count("tracker_objects", "Results at the best score.", WENG, "neither"),
    _count("ignored_tracker_objects", "Of these, those that are excused.", WENG, "neither"),
    _count("tracker_tracks", "Tracks of results.", WENG, "neither"),
)

CARDS = (*OVER_RECALLS, *COUNTS)
