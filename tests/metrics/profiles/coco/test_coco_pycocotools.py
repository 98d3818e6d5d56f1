import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.metrics.profiles.coco.oracles.make_coco import CLASSES, SEEDS, Boxes, random_images

from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.coco.profile import CocoProfile
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence, Steps

NAMES = ("ap", "ap50", "ap75", "aps", "apm", "apl", "ar1", "ar10", "ar100", "ars", "arm", "arl")
FROZEN = json.loads((Path(__file__).parent / "oracles" / "coco.json").read_text())


def objects(boxes: Boxes, first: int, last: int, order: np.ndarray) -> Objects:
    """Boxes of some images, in another order within them."""
    rows = order[np.argsort(boxes.image[order], kind="stable")]
    rows = rows[(boxes.image[rows] >= first) & (boxes.image[rows] < last)]
    return Objects(
        boxes.image[rows] - first, np.array(CLASSES)[boxes.label[rows]], np.full(len(rows), -1), boxes.score[rows],
        xyxy_px=boxes.xyxy[rows], ignore=boxes.crowd[rows],
    )  # fmt: skip


def sequences(seed: int, num_parts: int, shuffle: int = 0) -> list[Sequence]:
    num_images, truth, estimates = random_images(seed)
    rng = np.random.Generator(np.random.PCG64(shuffle))
    borders = np.linspace(0, num_images, num_parts + 1).astype(int).tolist()
    return [
        Sequence(
            f"part {k}",
            Steps.of_one_stream(last - first),
            *(objects(boxes, first, last, rng.permutation(len(boxes.image))) for boxes in (truth, estimates)),
        )
        for k, (first, last) in enumerate(pairwise(borders))
    ]


def scores(parts: list[Sequence]) -> list[Score]:
    profile = CocoProfile()
    return profile.scores(evaluate(profile, parts).total, "all")


@pytest.mark.parametrize("seed", SEEDS)
def test_all_numbers_are_those_of_pycocotools(seed: int) -> None:
    found = scores(sequences(seed, 1))
    for name, expected in zip(NAMES, FROZEN[str(seed)]["stats"], strict=True):
        score = next(s for s in found if s.metric == name and s.class_ == "all")
        assert (-1 if score.value is None else score.value) == pytest.approx(expected, abs=1e-12), name
    for label, values in FROZEN[str(seed)]["classes"].items():
        own = {s.metric: s.value for s in found if s.class_ == label}
        for name, expected in zip(("ap", "ap50", "ap75"), values, strict=True):
            value = own.get(name)
            assert (-1 if value is None else value) == pytest.approx(expected, abs=1e-12), (label, name)


def test_order_and_grouping_change_nothing() -> None:
    expected = scores(sequences(2, 1))
    for shuffle in range(3):
        assert [s.value for s in scores(sequences(2, 1, shuffle))] == [s.value for s in expected]
    parts = sequences(2, 3)
    profile = CocoProfile()
    a, b, c = (profile.measure(part) for part in parts)
    whole = profile.scores(a + b + c, "all")
    assert whole == profile.scores(c + (b + a), "all") == profile.scores((a + c) + b, "all")
    assert [(s.value, s.counts) for s in whole] == [(s.value, s.counts) for s in expected]


def test_truth_finds_itself() -> None:
    (part,) = sequences(3, 1)
    real = part.truth[~part.truth.ignore]
    found = scores([replace(part, estimates=real)])
    names = ("ap", "ap50", "ap75", "aps", "apm", "apl", "ar100", "ars", "arm", "arl")
    assert {s.value for s in found if s.metric in names and s.class_ == "all"} == {1.0}


def test_a_false_alarm_never_helps() -> None:
    (part,) = sequences(1, 1)
    alarm = replace(part.estimates[:1], xyxy_px=np.array([[2e3, 2e3, 2.1e3, 2.1e3]]), score=np.ones(1))
    columns = ("step", "label", "track_id", "score", "xyxy_px", "ignore")
    both = {name: np.concatenate([getattr(o, name) for o in (alarm, part.estimates)]) for name in columns}
    before, after = scores([part]), scores([replace(part, estimates=Objects(**both))])
    pairs = [(b.value, a.value) for b, a in zip(before, after, strict=True) if b.value is not None]
    assert all(a <= b for b, a in pairs)
    assert any(a < b for b, a in pairs)
