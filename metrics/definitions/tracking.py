"""Definitions of tracking metrics, also of those that only benchmarks count."""

from fbench.metrics.definitions.definition import (
    BERNARDIN,  # fmt: skip
    CAESAR,
    FBENCH,  # fmt: skip
    LI,  # fmt: skip
    LUITEN,  # fmt: skip
    MOTMETRICS,  # fmt: skip
    RISTANI,  # fmt: skip
    SHARE,  # fmt: skip
    TRACKEVAL,  # fmt: skip
    WENG,
    Better,  # fmt: skip
    MetricDefinition,  # fmt: skip
    Source,  # fmt: skip
)

_NO_TRUTH = "there are no truth boxes"
_NO_IDS = f"{_NO_TRUTH}, or one side has no ids"
_BEST = "At the score with the best MOTA."

CLEAR = (
    MetricDefinition(
        "mota",
        "Tracking accuracy: misses, false alarms and switches of identity together.",
        "1 - (FN + FP + IDSW) / GT, summed over frames and sequences before dividing",
        "-inf to 1",
        "higher",
        _NO_IDS,
        BERNARDIN,
        by_profile={
            "kitti-3dmot": _BEST,
            "nuscenes-tracking": f"{_BEST} Floored at 0; over classes their mean.",
            "trackeval-kitti": "Not clipped; pairs of the frame before go first.",
        },
    ),
    MetricDefinition(
        "mota_no_fp",
        "MOTA without false alarms, which some publications call MOTA; rewards flooding the scene.",
        "1 - (FN + IDSW) / GT",
        "-inf to 1",
        "higher",
        _NO_IDS,
        FBENCH,
    ),
    MetricDefinition(
        "motp",
        "How precisely matched boxes lie.",
        "mean over matches of the overlap, or of the distance [m] where boxes match by distance",
        "0 to 1, or from 0 up",
        "higher",
        "there are no matches",
        BERNARDIN,
        "iou or m",
        by_profile={
            "motmetrics": "Mean of 1 - IoU, or of the distance [m]: lower is better.",
            "nuscenes-tracking": f"Distance [m]: lower is better. {_BEST}",
            "default": "In space the mean distance [m]: lower is better.",
        },
    ),
    MetricDefinition(
        "motp_sum",
        "Sum of which MOTP is the mean.",
        "sum over matches of the overlap, or of the distance [m]",
        "from 0 up",
        "neither",
        "",
        TRACKEVAL,
        "1 or m",
    ),
    MetricDefinition(
        "moda",
        "Accuracy of boxes alone.",
        "1 - (FN + FP) / GT",
        "-inf to 1",
        "higher",
        _NO_TRUTH,
        BERNARDIN,
        by_profile={"kitti-3dmot": _BEST},
    ),
    MetricDefinition(
        "modp",
        "Precision of boxes by frame.",
        "mean over frames of the mean overlap of matches",
        SHARE,
        "higher",
        _NO_TRUTH,
        BERNARDIN,
        by_profile={"kitti-3dmot": _BEST},
    ),
    MetricDefinition(
        "motal",
        "MOTA in which switches count by their logarithm.",
        "1 - (FN + FP + log10 IDSW) / GT",
        "-inf to 1",
        "higher",
        _NO_TRUTH,
        TRACKEVAL,
        by_profile={"kitti-3dmot": _BEST},
    ),
    MetricDefinition(
        "smota",
        "MOTA in which hits count by their overlap.",
        "(sum of overlaps - FP - IDSW) / GT",
        "-inf to 1",
        "higher",
        f"{_NO_TRUTH}, or boxes match by distance",
        TRACKEVAL,
    ),
    MetricDefinition(
        "clr_f1",
        "F1 of CLEAR's matches.",
        "2 TP / (2 TP + FN + FP)",
        SHARE,
        "higher",
        "there are neither truth nor results",
        TRACKEVAL,
    ),
    MetricDefinition("clr_re", "Recall of CLEAR's matches.", "TP / (TP + FN)", SHARE, "higher", _NO_TRUTH, TRACKEVAL),
    MetricDefinition(
        "clr_pr", "Precision of CLEAR's matches.", "TP / (TP + FP)", SHARE, "higher", "there are no results", TRACKEVAL
    ),
    MetricDefinition(
        "mtr",
        "Share of truth tracks that are mostly tracked.",
        "MT / tracks",
        SHARE,
        "higher",
        "there are no truth tracks",
        TRACKEVAL,
    ),
    MetricDefinition(
        "ptr",
        "Share of truth tracks that are partly tracked.",
        "PT / tracks",
        SHARE,
        "neither",
        "there are no truth tracks",
        TRACKEVAL,
    ),
    MetricDefinition(
        "mlr",
        "Share of truth tracks that are mostly lost.",
        "ML / tracks",
        SHARE,
        "lower",
        "there are no truth tracks",
        TRACKEVAL,
    ),
    MetricDefinition(
        "fp_per_frame", "False alarms a frame.", "FP / frames", "from 0 up", "lower", "there are no frames", TRACKEVAL
    ),
    MetricDefinition(
        "occlusion_survival",
        "Share of occlusions after which an object has the id that it had before.",
        "occlusions with one id before and after / occlusions of tracked objects; by length in slices",
        SHARE,
        "higher",
        "no tracked object was occluded",
        FBENCH,
    ),
)


def _count(
    name: str, meaning: str, source: Source, better: Better = "lower", variants: dict[str, str] | None = None
) -> MetricDefinition:
    return MetricDefinition(
        name,
        meaning,
        "a count",
        "from 0 up",
        better,
        "what it is counted of isn't there",
        source,
        is_count=True,
        by_profile=variants or {},
    )


_KITTI = {"kitti-3dmot": "A share of truth tracks, at the score with the best MOTA."}
CLEAR_COUNTS = (
    _count("idsw", "Truth objects matched to another id than at their last match, over any gap.", BERNARDIN),
    _count("frag", "How often a truth track is found again after frames without a match.", LI),
    _count("mt", "Truth tracks of which more than 80 % of the boxes are found.", LI, "higher", _KITTI),
    _count("pt", "Truth tracks that are neither mostly tracked nor mostly lost.", LI, "neither", _KITTI),
    _count("ml", "Truth tracks of which less than 20 % of the boxes are found.", LI, "lower", _KITTI),
    _count("clr_tp", "Boxes that CLEAR matches.", TRACKEVAL, "higher"),
    _count("clr_fn", "Truth boxes that CLEAR doesn't match.", TRACKEVAL),
    _count("clr_fp", "Results that CLEAR doesn't match.", TRACKEVAL),
    _count(
        "clr_frames", "Frames of the sequences, those without truth and without results left out.", TRACKEVAL, "neither"
    ),
    _count("idtp", "Boxes of tracks that belong together in the best assignment of whole tracks.", RISTANI, "higher"),
    _count("idfn", "Truth boxes that don't.", RISTANI),
    _count("idfp", "Results that don't.", RISTANI),
    _count("dets", "Results that count.", TRACKEVAL, "neither"),
    _count("gt_dets", "Truth boxes that count.", TRACKEVAL, "neither"),
    _count("gt_ids", "Truth tracks that count.", TRACKEVAL, "neither"),
    _count(
        "ids",
        "Tracks of results that count.",
        TRACKEVAL,
        "neither",
        {
            "nuscenes-tracking": "Switches of identity: lower is better.",
            "kitti-3dmot": "Switches of identity: lower is better.",
        },
    ),
    _count("num_unique_objects", "Truth tracks.", MOTMETRICS, "neither"),
    _count("mostly_tracked", "Truth tracks of which at least 80 % of the boxes are found.", MOTMETRICS, "higher"),
    _count("partially_tracked", "Truth tracks of which 20 % to 80 % are found.", MOTMETRICS, "neither"),
    _count("mostly_lost", "Truth tracks of which less than 20 % are found.", MOTMETRICS),
    _count("num_false_positives", "Results that match nothing.", MOTMETRICS),
    _count("num_misses", "Truth boxes that match nothing.", MOTMETRICS),
    _count("num_switches", "Truth objects matched to another id than at their last match.", MOTMETRICS),
    _count("num_fragmentations", "How often a truth track is found again after frames without a match.", MOTMETRICS),
    _count("num_transfer", "Ids that go from one truth track to another.", MOTMETRICS),
    _count("num_ascend", "Switches to an id that is new.", MOTMETRICS),
    _count("num_migrate", "Ids that go to a truth track that is new.", MOTMETRICS),
)

IDENTITY = (
    MetricDefinition(
        "idf1",
        "How long objects keep one identity, over whole tracks.",
        "2 IDTP / (2 IDTP + IDFP + IDFN), tracks assigned one to one for most IDTP",
        SHARE,
        "higher",
        _NO_IDS,
        RISTANI,
    ),
    MetricDefinition(
        "idp", "Precision of identities.", "IDTP / (IDTP + IDFP)", SHARE, "higher", "there are no results", RISTANI
    ),
    MetricDefinition("idr", "Recall of identities.", "IDTP / (IDTP + IDFN)", SHARE, "higher", _NO_IDS, RISTANI),
)


def _hota(name: str, meaning: str, formula: str, undefined: str = _NO_IDS) -> MetricDefinition:
    by_alpha = f"{formula}; mean over alpha = 0.05, 0.1 ... 0.95"
    return MetricDefinition(name, meaning, by_alpha, SHARE, "higher", undefined, LUITEN)


HOTA = (
    _hota("hota", "Finding boxes and keeping identities, both alike.", "sqrt(DetA AssA)"),
    _hota("deta", "How well boxes are found.", "TP / (TP + FN + FP)"),
    _hota("assa", "How well identities are kept.", "mean over TP c of TPA(c) / (TPA(c) + FNA(c) + FPA(c))"),
    _hota("loca", "How precisely matched boxes lie.", "mean over TP of the similarity", "there are no matches"),
    _hota("detre", "Recall of boxes.", "TP / (TP + FN)"),
    _hota("detpr", "Precision of boxes.", "TP / (TP + FP)", "there are no results"),
    _hota("assre", "Recall of associations.", "mean over TP c of TPA(c) / (TPA(c) + FNA(c))"),
    _hota("asspr", "Precision of associations.", "mean over TP c of TPA(c) / (TPA(c) + FPA(c))"),
    _hota("owta", "HOTA without false alarms, for open worlds.", "sqrt(DetRe AssA)"),
    _hota("hota_tp", "Matches.", "TP"),
    _hota("hota_fn", "Truth boxes without a match.", "FN"),
    _hota("hota_fp", "Results without a match.", "FP"),
    MetricDefinition(
        "hota_0", "HOTA at the lowest threshold.", "HOTA at alpha = 0.05", SHARE, "higher", _NO_IDS, LUITEN
    ),
    MetricDefinition(
        "loca_0",
        "LocA at the lowest threshold.",
        "LocA at alpha = 0.05",
        SHARE,
        "higher",
        "there are no matches",
        LUITEN,
    ),
    MetricDefinition(
        "hotaloca_0", "Both at the lowest threshold.", "HOTA LocA at alpha = 0.05", SHARE, "higher", _NO_IDS, LUITEN
    ),
)

TRACKING_DEFINITIONS = (*CLEAR, *CLEAR_COUNTS, *IDENTITY, *HOTA)


_BENCHMARKS_NO_TRUTH = "there is no truth of the class"
_RECALLS = "n recalls r: 40 from 0.1 to 1 in nuscenes-devkit, 1/40 to 1 in AB3DMOT"

OVER_RECALLS = (
    MetricDefinition(
        "amota",
        "MOTA averaged over recalls, so that no score threshold must be chosen.",
        f"mean over {_RECALLS}, of MOTAR_r = max(0, 1 - (IDS + FP + FN - (1 - r) P) / (r P))",
        SHARE,
        "higher",
        _BENCHMARKS_NO_TRUTH,
        CAESAR,
        by_profile={"kitti-3dmot": "Of MOTA, neither scaled nor clipped (Weng et al. 2020)."},
    ),
    MetricDefinition(
        "amotp",
        "MOTP averaged over recalls.",
        f"mean over {_RECALLS}, of MOTP",
        "from 0 up",
        "lower",
        _BENCHMARKS_NO_TRUTH,
        CAESAR,
        "m",
        by_profile={"kitti-3dmot": "Mean overlap: higher is better (Weng et al. 2020)."},
    ),
    MetricDefinition(
        "samota",
        "MOTA, scaled by recall, averaged over recalls.",
        "mean over r = 1/40 ... 1 of min(1, max(0, 1 - (FN + FP + IDS - (1 - r) P) / (r P)))",
        SHARE,
        "higher",
        _BENCHMARKS_NO_TRUTH,
        WENG,
    ),
    MetricDefinition(
        "motar",
        "MOTA scaled by recall, at the score with the best MOTA.",
        "max(0, 1 - (IDS + FP + FN - (1 - r) P) / (r P))",
        SHARE,
        "higher",
        _BENCHMARKS_NO_TRUTH,
        CAESAR,
    ),
    MetricDefinition(
        "faf",
        "False alarms in 100 samples, at the score with the best MOTA.",
        "100 FP / samples",
        "from 0 up",
        "lower",
        _BENCHMARKS_NO_TRUTH,
        CAESAR,
    ),
    MetricDefinition(
        "tid",
        "How long it takes until a truth track is first found.",
        "mean over tracks",
        "from 0 up",
        "lower",
        _BENCHMARKS_NO_TRUTH,
        CAESAR,
        "s",
    ),
    MetricDefinition(
        "lgd",
        "Longest gap of a truth track.",
        "mean over tracks",
        "from 0 up",
        "lower",
        _BENCHMARKS_NO_TRUTH,
        CAESAR,
        "s",
    ),
    MetricDefinition(
        "far",
        "False alarms a frame, at the score with the best MOTA.",
        "FP / frames",
        "from 0 up",
        "lower",
        _BENCHMARKS_NO_TRUTH,
        WENG,
    ),
    MetricDefinition(
        "best_threshold",
        "The score with the best MOTA.",
        "argmax over scores of MOTA",
        "any score",
        "neither",
        _BENCHMARKS_NO_TRUTH,
        WENG,
    ),
)


def _benchmarks_count(name: str, meaning: str, source: Source, better: Better = "lower") -> MetricDefinition:
    return MetricDefinition(name, meaning, "a count", "from 0 up", better, _BENCHMARKS_NO_TRUTH, source, is_count=True)


BENCHMARK_COUNTS = (
    _benchmarks_count("tp", "Matches, at the score with the best MOTA.", CAESAR, "higher"),
    _benchmarks_count("fp", "Results without a match, at the score with the best MOTA.", CAESAR),
    _benchmarks_count("fn", "Truth boxes without a match, at the score with the best MOTA.", CAESAR),
    _benchmarks_count("gt", "Truth boxes; over classes their mean.", CAESAR, "neither"),
    _benchmarks_count("itp", "Matches with truth that is ignored.", WENG, "neither"),
    _benchmarks_count("ifn", "Ignored truth boxes without a match.", WENG, "neither"),
    _benchmarks_count("gt_objects", "Truth boxes that are matched, ignored ones too.", WENG, "neither"),
    _benchmarks_count("ignored_gt_objects", "Of these, those that are ignored.", WENG, "neither"),
    _benchmarks_count("gt_tracks", "Truth tracks.", WENG, "neither"),
    _benchmarks_count("tracker_objects", "Results at the best score.", WENG, "neither"),
    _benchmarks_count("ignored_tracker_objects", "Of these, those that are excused.", WENG, "neither"),
    _benchmarks_count("tracker_tracks", "Tracks of results.", WENG, "neither"),
)

BENCHMARK_DEFINITIONS = (*OVER_RECALLS, *BENCHMARK_COUNTS)
