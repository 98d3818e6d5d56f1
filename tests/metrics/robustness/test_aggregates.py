"""Aggregates against what the benchmarks print, computed from the rows that they print.

Rows: scores [%] of each corruption, the mean over its severities, then aggregates as printed. SemanticKITTI-C, KITTI-C
of the README of Robo3D (commit eb81d5c), nuScenes-C of that of RoboBEV (77d7718), MultiCorrupt of its README (6cd6225).
"""

import numpy as np
import pytest

from fbench.metrics.robustness.aggregates import (
    corruption_error,
    relative_change,
    relative_corruption_error,
    relative_resistance,
    resilience_rate,
)

SEMANTIC_KITTI = {
    "MinkUNet18": (62.76, [55.87, 53.99, 53.28, 32.92, 56.32, 58.34, 54.43, 46.05]),
    "MinkUNet34": (63.78, [53.54, 54.27, 50.17, 33.80, 57.35, 58.38, 54.88, 46.95]),
    "FRNet": (67.55, [47.61, 62.15, 57.08, 56.80, 62.54, 40.94, 58.11, 47.30]),
}
KITTI = {
    "CenterPoint": (68.70, [53.10, 68.71, 48.56, 47.94, 49.88, 66.00, 58.90, 45.12]),
    "PVRCNN": (72.36, [55.36, 72.89, 52.12, 54.44, 56.88, 70.39, 63.00, 48.01]),
}
NUSCENES = {
    "DETR3D": (42.24, [28.59, 26.04, 31.77, 26.61, 40.02, 27.86, 39.12, 19.13]),
    "PolarFormer-R101": (46.02, [31.33, 28.08, 35.09, 32.21, 43.04, 25.54, 42.62, 23.04]),
    "SOLOFusion": (53.81, [38.06, 34.64, 40.58, 36.42, 43.29, 26.26, 44.80, 13.76]),
    "BEVDet-SwinT": (40.37, [26.09, 21.15, 22.78, 21.28, 21.91, 4.90, 24.50, 6.80]),
}
MULTICORRUPT = {  # resistance ability by NDS
    "CMT": (0.729, [0.786, 0.937, 0.948, 0.806, 0.974, 0.841, 0.925, 0.833, 0.809, 0.788]),
    "BEVFusion": (0.714, [0.676, 0.967, 0.969, 0.752, 0.974, 0.866, 0.872, 0.774, 0.705, 0.742]),
}


def scores(table, name):
    """Scores (C, 1) of a model, 0 to 1, and its clean score."""
    clean, row = table[name]
    return np.array(row)[:, None] / 100, clean / 100


@pytest.mark.parametrize(
    ("table", "name", "baseline", "mce", "mrr"),
    [
        (SEMANTIC_KITTI, "MinkUNet34", "MinkUNet18", 100.61, 80.22),
        (SEMANTIC_KITTI, "FRNet", "MinkUNet18", 96.80, 80.04),
        (NUSCENES, "PolarFormer-R101", "DETR3D", 96.06, 70.88),
        (NUSCENES, "SOLOFusion", "DETR3D", 92.86, 64.53),
        (NUSCENES, "BEVDet-SwinT", "DETR3D", 116.48, 46.26),
        (KITTI, "CenterPoint", "CenterPoint", 100.00, 79.73),
        (KITTI, "PVRCNN", "CenterPoint", 90.04, 81.73),
    ],
)
def test_published_values_reproduce_to_the_printed_digit(table, name, baseline, mce, mrr):
    score, clean = scores(table, name)
    base, _ = scores(table, baseline)
    assert round(100 * corruption_error(score, base).mean(), 2) == mce
    assert round(100 * resilience_rate(score, clean).mean(), 2) == mrr


def test_mce_is_a_mean_of_ratios():
    score, base = scores(SEMANTIC_KITTI, "MinkUNet34")[0], scores(SEMANTIC_KITTI, "MinkUNet18")[0]
    ratio_of_sums = (1 - score).sum() / (1 - base).sum()
    assert round(100 * ratio_of_sums, 2) == 100.48


@pytest.mark.parametrize(("name", "mra"), [("CMT", 0.865), ("BEVFusion", 0.830)])
def test_mean_resistance_ability_of_multicorrupt(name, mra):
    clean, ability = MULTICORRUPT[name]
    assert round(float(resilience_rate(np.array(ability)[:, None] * clean, clean).mean()), 3) == mra


def test_mean_relative_resistance_of_multicorrupt():
    """7.161 %, from rows of three digits: a rounding of 0.0005 in each of twenty is 0.07 % at most."""
    scores_of = [np.array(ability)[:, None] * clean for clean, ability in MULTICORRUPT.values()]
    assert 100 * relative_resistance(*scores_of).mean() == pytest.approx(7.161, abs=0.07)


def test_by_hand_over_severities():
    score, clean = np.array([[0.8, 0.6], [0.5, 0.1]]), np.array(0.8)
    base, base_clean = np.array([[0.4, 0.4], [0.5, 0.3]]), np.array(0.5)
    assert corruption_error(score, base).tolist() == pytest.approx([0.6 / 1.2, 1.4 / 1.2])
    assert relative_corruption_error(score, clean, base, base_clean).tolist() == pytest.approx([0.2 / 0.2, 1.0 / 0.2])
    assert relative_resistance(score, base).tolist() == pytest.approx([1.4 / 0.8 - 1, 0.6 / 0.8 - 1])
    assert relative_change(score, clean).ravel().tolist() == pytest.approx([0, -0.25, -0.375, -0.875])


def test_what_cannot_be_divided_is_nan():
    one = np.ones((1, 2))
    assert np.isnan(corruption_error(one * 0.5, one)).all()
    assert np.isnan(resilience_rate(one, np.array(0.0))).all()
    risen = relative_corruption_error(one * 0.5, np.array(0.6), one * 0.9, np.array(0.8))
    assert np.isnan(risen).all()  # the baseline got better


def test_resamples_lead():
    score, clean = np.random.default_rng(0).random((7, 3, 5)), np.full(7, 0.9)
    whole = resilience_rate(score, clean)
    assert whole.shape == (7, 3)
    assert whole[4].tolist() == resilience_rate(score[4], clean[4]).tolist()
