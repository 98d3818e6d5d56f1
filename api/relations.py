"""Metamorphic relations of a replay: whether its results hold where they must, without any truth."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from fbench.api.replays import make_plan, name_pipeline, open_requested
from fbench.api.scores import score_folder
from fbench.metrics.comparison.cells import CellName, CellPair, CellSide
from fbench.metrics.comparison.reference import compare_by_base
from fbench.metrics.comparison.relations import ORIGINAL, RELATIONS_FILE, KeptRelation, KeptRelations
from fbench.replay.check.relations import RELATIONS, RelatedPipeline, Relation
from fbench.replay.check.verify import workplace
from fbench.replay.contracts.errors import LogError, RunError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import give_log
from fbench.replay.data.comparison import Comparison, ObjectChange
from fbench.replay.data.files import replace_text
from fbench.replay.engine.loop import replay
from fbench.replay.engine.read_ahead import open_ahead
from fbench.replay.runs.folder import Run
from fbench.replay.setup.request import ReplayRequest


@dataclass(frozen=True)
class HeldRelation:
    """What became of one relation."""

    name: str
    change: str  # Of what the pipeline gets
    least: float  # Agreement that must be reached
    comparison: Comparison | None  # With the results for the original; `None`: it can't be tried on this log
    reason: str = ""  # Why it can't, why it says nothing, or why the pipeline failed
    has_failed: bool = False  # The pipeline, which didn't with the original

    def value(self, metric: str) -> float | None:
        """Return a number of the comparison; `None` where there is none."""
        rows = self.comparison.rows if self.comparison is not None else ()
        return next((row.head for row in rows if row.metric == metric), None)

    @property
    def agreement(self) -> float | None:
        """The lower agreement of detections and tracks; `None` where there are no boxes, or it couldn't be tried."""
        values = [self.value(name) for name in ("agreement_detections", "agreement_tracks")]
        return min((value for value in values if value is not None), default=None)

    @property
    def is_violated(self) -> bool:
        """Whether results changed more than they may."""
        return self.has_failed or (self.agreement is not None and self.agreement < self.least)


@dataclass(frozen=True)
class Relations:
    """All relations, and where results differ."""

    held: tuple[HeldRelation, ...]

    @property
    def is_violated(self) -> bool:
        """Whether any is violated."""
        return any(one.is_violated for one in self.held)

    @property
    def objects(self) -> tuple[ObjectChange, ...]:
        """Objects that only one side has, of violated relations: those of the worst relation first, and of each the
        nearest and longest.
        """
        worst = sorted((one for one in self.held if one.is_violated), key=lambda one: (one.agreement or 0) - one.least)
        return tuple(o for one in worst if one.comparison is not None for o in one.comparison.objects)


def check_relations(
    request: ReplayRequest, keep: Path | None = None, progress: Callable[[int, int], None] = lambda done, total: None
) -> Relations:
    """Replay a log as it is and changed in ways that must not change results, and compare.

    Args:
        request: The replay.
        keep: Folder for the runs and a summary, which `fbench compare` takes; `None`: they are removed.
        progress: Gets the number of replays that are done, and of all.

    Raises:
        ConfigError, LogError, RunError: where the log can't be replayed as it is.
    """
    with workplace(keep) as folder:
        progress(0, len(RELATIONS) + 1)
        base = _replay(request, Relation(), folder / ORIGINAL)
        held = []
        for done, (name, (relation, change)) in enumerate(RELATIONS.items(), 1):
            progress(done, len(RELATIONS) + 1)
            held.append(_check(request, base, name, relation(), change, folder))
        progress(len(RELATIONS) + 1, len(RELATIONS) + 1)
        rows = [
            KeptRelation(relation=o.name, least=o.least, agreement=o.agreement, violated=o.is_violated, reason=o.reason)
            for o in held
        ]
        text = KeptRelations(format=1, relations=rows).model_dump_json(indent=1)
        replace_text(folder / RELATIONS_FILE, f"{text}\n")
        if keep is not None:
            score_folder(base.folder, request.scoring)
        return Relations(tuple(held))


def _check(request: ReplayRequest, base: Run, name: str, relation: Relation, change: str, folder: Path) -> HeldRelation:
    if name == "world" and not _has_poses(request):
        return HeldRelation(name, change, relation.least, None, "the log has no poses")
    try:
        run = _replay(request, relation, folder / name)
    except LogError as error:
        return HeldRelation(name, change, relation.least, None, error.line)
    except RunError as error:
        return HeldRelation(name, change, relation.least, None, error.line, has_failed=True)
    cell = CellName(base.manifest.log.name, base.manifest.pipeline, name)
    pair = CellPair(cell, CellSide(base.manifest, (), base), CellSide(run.manifest, (), run))
    held = HeldRelation(name, change, relation.least, compare_by_base([pair], (), ()))
    return held if held.agreement is not None else replace(held, reason="neither run has a box")


def _has_poses(request: ReplayRequest) -> bool:
    return bool(request.resolve().log.open(FaultLog()).poses)


def _replay(request: ReplayRequest, relation: Relation, folder: Path) -> Run:
    options, name, faults = request.resolve(), name_pipeline(request), FaultLog()
    with open_requested(request, options.settings) as (pipeline, parameters):
        give_log(pipeline, name, lambda: options.log.open(faults))
        related = RelatedPipeline(pipeline, relation)
        plan = replace(make_plan(options, related, name, parameters), num_media=0)
        with open_ahead(options.log.open, faults, options.read_ahead) as reader:
            replay(reader, plan, folder, faults)
    return Run(folder)
