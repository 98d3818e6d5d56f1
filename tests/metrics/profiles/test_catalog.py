"""Profiles by name, as data."""

import inspect
import json
from typing import get_args

import pytest
from tests.program import fbench

from fbench.metrics.definitions.catalog import COUNTS, DEFINITIONS, Better, definition_of
from fbench.metrics.files.sequences import open_files
from fbench.metrics.profiles.catalog import describe_rules, profile_names, profile_of
from fbench.metrics.profiles.choose import choose_profile, evaluate, fit_profile, only
from fbench.metrics.profiles.default import DefaultProfile
from fbench.metrics.profiles.remarks import lines
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.contracts.profiles import Match

CAR = "{f} {i} Car 0 0 0.5 {l} 100 {r} 190 1.5 1.6 4.0 {x} 1.7 10.0 0.1"


def kitti(tmp_path, name, label="Car", score=""):
    rows = [CAR.format(f=f, i=i, l=100 + 200 * i, r=180 + 200 * i, x=6.0 * i) + score for f in range(4) for i in (0, 1)]
    path = tmp_path / name
    path.write_text("\n".join(rows).replace("Car", label) + "\n")
    return path


def submission(tmp_path, name, task):
    box: dict[str, object] = {
        "translation": [10.0, 20, 1],
        "size": [1.8, 4.2, 1.5],
        "rotation": [1.0, 0, 0, 0],
        "velocity": [1.0, 0.0],
    }
    box |= {f"{task}_name": "car", f"{task}_score": 0.5, "tracking_id": "a", "attribute_name": "vehicle.moving"}
    box |= {"ego_translation": [4.0, 2.0, 0.5], "num_pts": 5}
    path = tmp_path / name
    path.write_text(json.dumps({"meta": {}, "results": {str(i): [box] for i in range(3)}}))
    return path


def mot(tmp_path, name, result):
    tail = "-1,-1,-1" if result else "1,1"
    path = tmp_path / name
    path.write_text("".join(f"{f},{i},{100 * i},20,30,40,1,{tail}\n" for f in (1, 2, 3) for i in (1, 2)))
    return path


def mot15(tmp_path, name, result):
    path = tmp_path / name
    path.write_text("".join(f"{f},{i},{100 * i},20,30,40,1,-1,-1,-1\n" for f in (1, 2, 3) for i in (1, 2)))
    return path


def files_for(name, tmp_path):
    """Truth and results that are the same."""
    if name.startswith("nuscenes"):
        task = name.partition("-")[2]
        return submission(tmp_path, "t.json", task), submission(tmp_path, "r.json", task)
    if name.startswith("trackeval-mot"):
        write = mot15 if name.endswith("15") else mot
        return write(tmp_path, "gt.txt", False), write(tmp_path, "r.txt", True)
    return kitti(tmp_path, "t.txt"), kitti(tmp_path, "r.txt", score=" 0.5")


@pytest.mark.parametrize("name", profile_names())
def test_every_profile_scores_files_and_has_cards_for_all_that_it_says(name, tmp_path):
    pair = open_files(*files_for(name, tmp_path))
    profile = fit_profile(profile_of(name), pair, has_match=False)
    rows = evaluate(profile, pair.sequences()).scores()
    assert profile.name == name
    assert [row.metric for row in rows if row.metric not in DEFINITIONS] == []
    headlines = profile.facts.headlines
    assert set(headlines.metrics) <= {row.metric for row in rows}
    table = lines(rows, headlines)
    assert table[0].metric == headlines.metrics[0]
    # Results that are the truth are perfect, but KITTI looks at fewer recalls where there are few boxes.
    first = next(iter(table[0].scores.values()))
    assert first.value == pytest.approx({"kitti-object": 0.175, "kitti-3dmot": 0.175}.get(name, first.value))
    if name.startswith(("trackeval", "default", "motmetrics", "coco", "nuscenes-tracking")):
        assert first.value == pytest.approx(1)


@pytest.mark.parametrize("name", profile_names())
def test_every_profile_is_data(name):
    profile = profile_of(name)
    rules = describe_rules(profile)
    assert profile.summary
    assert "\n" not in profile.summary
    assert inspect.getdoc(type(profile))
    assert rules
    assert all(text and "object at 0x" not in text and "<" not in text for text in rules.values())
    assert profile.facts.space in ("2d", "3d", "both")


def test_what_profiles_say_is_in_order():
    assert describe_rules(profile_of("kitti-3dmot"))["rules.match"] == "iou3d 0.25"
    assert (
        describe_rules(profile_of("trackeval-kitti"))["preparation.classes[1].distractors"] == "person, person_sitting"
    )


def test_unknown_names():
    with pytest.raises(ConfigError, match=r"unknown profile 'kitti3dmot'; did you mean 'kitti-3dmot'\?"):
        profile_of("kitti3dmot")
    with pytest.raises(ConfigError, match=r"unknown metric 'hotaa'; did you mean 'hota'\?"):
        definition_of("hotaa")


@pytest.mark.parametrize(
    ("name", "match"),
    [("kitti-3dmot", "bev:2"), ("coco", "iou3d:0.5"), ("nuscenes-detection", "iou2d:0.5"), ("kitti-object", "bev:2")],
)
def test_matches_that_a_profile_cant_do(name, match):
    with pytest.raises(ConfigError, match=name):
        choose_profile(name, match)


def test_default_matches_in_space_where_both_sides_are_there(tmp_path):
    solid = kitti(tmp_path, "t.txt")
    flat = tmp_path / "flat.txt"
    flat.write_text(" ".join(["0 0 Car -1 -1 -1 100 100 180 190", *["-1"] * 7]) + "\n")
    cases = (
        (None, solid, Match("bev", 2.0)),
        (None, flat, Match("iou2d", 0.5)),
        ("iou3d:0.3", flat, Match("iou3d", 0.3)),
    )
    for match, results, expected in cases:
        found = fit_profile(choose_profile("default", match), open_files(solid, results), match is not None)
        assert isinstance(found, DefaultProfile)
        assert found.match == expected


def test_default_has_all_vehicles_and_each_label(tmp_path):
    truth = kitti(tmp_path, "t.txt", "Cyclist")
    pair = open_files(truth, truth)
    rows = evaluate(profile_of("default"), pair.sequences()).scores()
    assert {row.class_ for row in rows} == {"bicycle"}
    vans = kitti(tmp_path, "v.txt", "Van")
    rows = evaluate(profile_of("default"), open_files(vans, vans).sequences()).scores()
    assert list(dict.fromkeys(row.class_ for row in rows)) == ["vehicle", "van"]


def test_default_adds_sequences_in_any_order(tmp_path):
    parts = [
        evaluate(profile_of("default"), open_files(p, p).sequences()).total
        for p in (kitti(tmp_path, "a.txt"), kitti(tmp_path, "b.txt", "Van"), kitti(tmp_path, "c.txt", "Tram"))
    ]
    a, b, c = parts
    profile = profile_of("default")
    assert profile.scores((a + b) + c, "all") == profile.scores(c + (b + a), "all")


@pytest.mark.parametrize("name", ["kitti-3dmot", "nuscenes-detection", "nuscenes-tracking"])
def test_profiles_in_space_refuse_boxes_in_images(name, tmp_path):
    files = mot(tmp_path, "gt.txt", False), mot(tmp_path, "r.txt", True)
    with pytest.raises(MetricError):
        evaluate(profile_of(name), open_files(*files).sequences())


def test_nuscenes_needs_to_know_where_the_ego_is_and_when(tmp_path):
    truth = submission(tmp_path, "t.json", "tracking")
    text = truth.read_text()
    truth.write_text(text.replace("ego_translation", "nothing"))
    with pytest.raises(ConfigError, match=r"nuscenes-detection: .* nobody tells where the ego is; give truth"):
        fit_profile(profile_of("nuscenes-detection"), open_files(truth, truth), False)
    truth.write_text(text.replace('"0":', '"x":'))
    with pytest.raises(ConfigError, match=r"nuscenes-tracking: nobody tells when the samples are; put samples.csv"):
        fit_profile(profile_of("nuscenes-tracking"), open_files(truth, truth), False)


def test_only_some_classes(tmp_path):
    files = kitti(tmp_path, "t.txt"), kitti(tmp_path, "r.txt")
    rows = evaluate(profile_of("trackeval-kitti"), open_files(*files).sequences()).scores()
    assert {row.class_ for row in only(rows, ("car",))} == {"car"}
    with pytest.raises(ConfigError, match=r"--class cars: the profile has no rows of it; did you mean 'car'"):
        only(rows, ("cars",))


def test_cards_are_whole():
    for name, card in DEFINITIONS.items():
        assert card.better in get_args(Better)
        assert name == card.name == card.name.lower()
        assert card.meaning.endswith(".")
        assert card.formula
        assert card.range
        assert card.source.url.startswith("http")
        assert 1975 < card.source.year < 2030
        assert set(card.by_profile) <= set(profile_names())
        assert card.undefined != "" or card.is_count or card.name in ("motp_sum",)
    assert {"idsw", "mt", "clr_tp"} <= COUNTS
    wanted = (
        "f1 precision recall coverage mota mota_no_fp motp idsw frag mt pt ml idf1 idp idr hota deta assa loca detre "
    )
    wanted += "detpr assre asspr owta amota amotp samota motar map ap ate ase aoe ave aae nds ap40 ap11 aos "
    wanted += "occlusion_survival distance_error range_rate_error horizon_50 horizon_80 horizon_90"
    assert set(wanted.split()) <= set(DEFINITIONS)


def test_default_refuses_an_id_twice_among_all_vehicles(tmp_path):
    """A car and a truck of one id: each alone is one object, as vehicles they are one in two places (GT003)."""
    text = kitti(tmp_path, "t.txt").read_text().splitlines()
    first = text[0].split()
    twin = " ".join([*first[:2], "Truck", *first[3:]])
    (tmp_path / "t.txt").write_text("\n".join([*text, twin]) + "\n")
    pair = open_files(tmp_path / "t.txt", kitti(tmp_path, "r.txt", score=" 0.5"))
    with pytest.raises(MetricError, match=r"id .* twice") as caught:
        evaluate(profile_of("default"), pair.sequences())
    assert caught.value.code == "GT003"


OUTSIDER = '''
from dataclasses import dataclass, replace
from fbench.replay.contracts.profiles import Facts, Match
from fbench.replay.data.scores import Score

@dataclass(frozen=True)
class Total:
    num: int

    def __add__(self, other):
        return Total(self.num + other.num)

@dataclass(frozen=True)
class NumTruth:
    """Counts truth."""

    name: str = "num-truth"
    summary: str = "number of truth boxes"
    match: Match = Match("iou2d", 0.5)
    result_labels: frozenset[str] = frozenset()
    facts: Facts = Facts(judges_tracks=False, space="both")

    def with_match(self, match):
        return replace(self, match=match)

    def measure(self, sequence):
        return Total(len(sequence.truth))

    def scores(self, statistics, part):
        return [Score("num_truth", "all", part, str(self.match), statistics.num, None, "count", {})]

class Broken(NumTruth):
    def __init__(self):
        raise KeyError("here")

@dataclass(frozen=True)
class WithoutFacts(NumTruth):
    facts: None = None
'''


def test_a_profile_of_an_outsider_scores_files(tmp_path, capsys):
    (tmp_path / "mine.py").write_text(OUTSIDER)
    name = f"{tmp_path / 'mine.py'}:NumTruth"
    pair = open_files(kitti(tmp_path, "t.txt"), kitti(tmp_path, "r.txt", score=" 0.5"))
    profile = fit_profile(choose_profile(name, "iou2d:0.3"), pair, has_match=True)
    rows = evaluate(profile, pair.sequences()).scores()
    assert [(row.metric, row.value, row.matching) for row in rows] == [("num_truth", 8, "iou2d 0.3")]
    assert describe_rules(profile)["match"] == "iou2d 0.3"
    files = ("--truth", tmp_path / "t.txt", "--detections", tmp_path / "r.txt")
    assert fbench("score", *files, "--profile", name) == 0
    assert "num_truth" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Total", r"profile '.*mine.py:Total' can't be made: TypeError"),
        ("Broken", r"can't be made: KeyError: 'here'"),
        ("WithoutFacts", r"isn't one: see Profile and Facts in fbench.replay.contracts.profiles"),
        ("Facts", r"has no class 'Facts'"),
    ],
)
def test_what_is_no_profile(tmp_path, name, message):
    (tmp_path / "mine.py").write_text(OUTSIDER)
    with pytest.raises(ConfigError, match=message):
        profile_of(f"{tmp_path / 'mine.py'}:{name}")


def test_profiles_come_in_by_entry_points():
    assert profile_names()[0] == "default"
    assert profile_names()[1:] == sorted(profile_names()[1:])
