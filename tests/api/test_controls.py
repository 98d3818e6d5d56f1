"""Estimates by control variates: which runs belong together, and what counts as labeled."""

from pathlib import Path

import pytest
from tests.gate_runs import NUM_OBJECTS, some, write_drive

from fbench.api import estimate_by_controls
from fbench.api.scores import score_folder
from fbench.metrics.comparison.control import Controlled
from fbench.replay.contracts.errors import ConfigError, FbenchError, MetricError
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.runs.manifest import LogEntry

OTHER = LogEntry(name="other", log_id="other", digest="e" * 32, metadata={})


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("controls")
    write_drive(folder / "few", some(0.3, 5), every=3)
    write_drive(folder / "more", some(0.3, 7), every=3, log=OTHER)
    write_drive(folder / "set", some(0.3, 7), every=3, log=OTHER, parameters={"x": 1})
    write_drive(folder / "narrow", some(0.3, 7), every=3, log=OTHER)
    score_folder(folder / "narrow", ScoreOptions(range_m=30.0))
    write_drive(folder / "flat", some(0.3, 5), every=3, in_images=True)
    write_drive(folder / "blind", {(i, n) for i in range(120) for n in range(NUM_OBJECTS)}, every=3)
    write_drive(folder / "like", some(0.03, 6), has_truth=False, pipeline="late3d")
    write_drive(folder / "like-more", some(0.03, 6), has_truth=False, pipeline="late3d", log=OTHER)
    write_drive(folder / "like-set", has_truth=False, pipeline="late3d", log=OTHER, parameters={"x": 1})
    return folder


def test_logs_are_estimated_together(runs: Path) -> None:
    found = estimate_by_controls([runs / "few", runs / "more"], [runs / "like-more", runs / "like"])["recall"]
    assert isinstance(found, Controlled)
    assert (found.num_labeled, found.num_frames) == (80, 240)
    missed = sum(i % 3 == 0 for seed in (5, 7) for i, _ in some(0.3, seed))
    assert found.plain.value == pytest.approx(1 - missed / (80 * NUM_OBJECTS), abs=1e-6)


def test_frames_with_truth_in_images_alone_are_not_labeled_in_space(runs: Path) -> None:
    assert estimate_by_controls([runs / "flat"], [runs / "like"]) == estimate_by_controls(
        [runs / "few"], [runs / "like"]
    )


def test_one_undefined_number_says_so_and_the_others_are_there(runs: Path) -> None:
    found = estimate_by_controls([runs / "blind"], [runs / "like"])
    assert found["precision"] == "undefined over the labeled frames"
    assert isinstance(recall := found["recall"], Controlled)
    assert recall.plain.value == 0.0


@pytest.mark.parametrize(
    ("own", "controls", "kind", "said"),
    [
        (["few", "like-more"], ["like"], ConfigError, "like-more: is of another pipeline"),
        (["few", "set"], ["like", "like-more"], ConfigError, "set: is of another pipeline or other parameters"),
        (["few", "narrow"], ["like", "like-more"], ConfigError, "narrow: was scored with other options"),
        (["few", "few"], ["like"], ConfigError, "few: replayed the same as .*few"),
        (["few", "more"], ["like"], ConfigError, "no run of 'late3d' is on the log of .*more"),
        (["few"], ["like", "like"], ConfigError, "like: has pipeline and log of"),
        (["few", "more"], ["like", "like-set"], ConfigError, "like-set: has other parameters than"),
        (["like"], ["few"], MetricError, "like: no frame has truth"),
    ],
)
def test_what_does_not_belong_together_is_refused(
    runs: Path, own: list[str], controls: list[str], kind: type[FbenchError], said: str
) -> None:
    with pytest.raises(kind, match=said):
        estimate_by_controls([runs / name for name in own], [runs / name for name in controls])


def test_scores_of_another_version_of_the_metrics_are_refused(runs: Path, tmp_path: Path) -> None:
    write_drive(tmp_path / "old", some(0.3, 5), every=3)
    file = tmp_path / "old/scores.json"
    file.write_text(file.read_text(encoding="utf-8").replace('"value": 0.', '"value": 0.9', 1), encoding="utf-8")
    with pytest.raises(MetricError, match="other versions of metrics can't be compared"):
        estimate_by_controls([tmp_path / "old"], [runs / "like"])
