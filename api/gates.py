"""Gates: runs, suites and baselines compared by a policy, which says what must not become worse."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from fbench.api.baselines import load_baseline
from fbench.api.sides import Side, open_results, pair_cells
from fbench.metrics.comparison.cells import CellPair
from fbench.metrics.comparison.inference import ErrorRates
from fbench.metrics.comparison.objects import find_changes, find_divergence
from fbench.metrics.comparison.relations import ORIGINAL, RELATIONS_FILE, compare_relations
from fbench.metrics.comparison.verdicts import Judge, Rule, default_rules
from fbench.metrics.definitions.catalog import definition_of
from fbench.metrics.latency import compare_repeats
from fbench.replay.contracts.errors import (
    ConfigError,
    MetricError,
    did_you_mean,
    require_printable,
    require_whole,
    wrong_key,
)
from fbench.replay.contracts.faults import FAULTS
from fbench.replay.contracts.variants import read_config
from fbench.replay.data.comparison import Comparison, ObjectChange, Row, State, WorstFrame
from fbench.replay.data.scores import format_count
from fbench.replay.formats.documents import TomlError, find_line, parse_toml
from fbench.replay.runs.host import compare_hosts

_MOST_OBJECTS = 100
Share = Annotated[float, Field(ge=0, le=1)]
Name = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(require_printable)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class GateTable(_Strict):
    """`[[gate]]`: numbers that must not become worse; names may be patterns such as `range *`."""

    metric: Name
    class_: Annotated[Name, Field(alias="class")] = "vehicle"
    slice: Name = "all"
    condition: Name = "*"
    pipeline: Name = "*"
    space: Literal["own", "all"] = "own"
    kind: Literal["statistical", "absolute", "relative"] = "statistical"
    tolerance: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.01
    min: Annotated[float, Field(allow_inf_nan=False)] | None = None
    max: Annotated[float, Field(allow_inf_nan=False)] | None = None

    @field_validator("metric")
    @classmethod
    def _is_known(cls, metric: str) -> str:
        if not set(metric) & set("*?["):
            try:
                definition_of(metric)
            except ConfigError as error:
                raise ValueError(str(error)) from error
        return metric

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"no number is at least {self.min:g} and at most {self.max:g}")
        return self

    def rule(self) -> Rule:
        """Return it as what judges by it takes."""
        names = self.metric, self.class_, self.slice, self.condition, self.pipeline
        return Rule(*names, self.space, self.kind, self.tolerance, self.min, self.max)


class BudgetTable(_Strict):
    """`[budget]`: what the head may lack."""

    min_coverage: Share = 0.0  # Share of frames that must have truth
    failed_cells: Annotated[int, Field(ge=0)] = 0  # Cells that the base has, and the head hasn't
    failed_frames: Annotated[int, Field(ge=0)] | None = None  # Frames in which the pipeline failed
    incomplete: bool = False  # Whether runs may have lost data
    faults: dict[Name, Annotated[int, Field(ge=0)]] = {}  # Most faults of a code, over all cells

    @field_validator("faults")
    @classmethod
    def _are_known(cls, faults: dict[str, int]) -> dict[str, int]:
        for code in faults:
            if code not in FAULTS:
                raise ValueError(f"unknown fault '{code}'{did_you_mean(code, FAULTS)}")
        return faults


class LatencyTable(_Strict):
    """`[latency]`: ratio of the median times of repeats, which ran interleaved on one host."""

    max_ratio: Annotated[float, Field(gt=0, le=1000)]
    stage: Name = "total"
    min_repeats: Annotated[int, Field(ge=3, le=1000)] = 5


class Policy(_Strict):
    """A whole `gate.toml`."""

    version: Annotated[Literal[1], BeforeValidator(require_whole)]
    alpha: Annotated[float, Field(gt=0, lt=0.5)] = 0.05  # Chance of any false alarm among all statistical gates
    inconclusive: Literal["pass", "fail"] = "pass"
    inform: bool = True  # Whether numbers without a gate are judged, too, and shown
    gate: Annotated[tuple[GateTable, ...], Field(strict=False)] = (
        GateTable(metric="f1"), GateTable(metric="mota"),
    )  # fmt: skip
    budget: BudgetTable = BudgetTable()
    latency: LatencyTable | None = None


_TABLES: Mapping[str, type[BaseModel]] = {"gate": GateTable, "budget": BudgetTable, "latency": LatencyTable}


def load_policy(path: Path) -> Policy:
    """Read a policy. Raises ConfigError in one line with file, line and key where it isn't as it should be."""
    data = read_config(path, "name a gate.toml", "policy")
    text = data.decode("utf-8", "replace")
    try:
        policy = Policy.model_validate(parse_toml(data))
    except TomlError as error:
        raise ConfigError(f"{path}: not TOML: {error}", "CFG003") from error
    except ValidationError as error:
        line = find_line(text, error.errors(include_url=False)[0]["loc"])
        why = wrong_key(error, lambda keys: Policy if len(keys) == 1 else _TABLES.get(keys[0], Policy))
        raise ConfigError(f"{path}:{line}: {why}", "CFG003") from error
    names = [(own.metric, own.class_, own.slice, own.condition, own.pipeline, own.space) for own in policy.gate]
    for at, name in enumerate(names):
        if name in names[:at]:
            line = find_line(text, ("gate", at))
            raise ConfigError(
                f"{path}:{line}: 'gate.{at}': is about the numbers of 'gate.{names.index(name)}'", "CFG003"
            )
    return policy


@dataclass(frozen=True)
class CompareRequest:
    """What is compared, and how it is judged."""

    base: Path
    """A run folder, a suite folder, or a baseline file."""
    head: Path
    """A run folder or a suite folder."""
    tolerance: float = 0.0
    """Largest drop of F1 and MOTA that passes, without a policy."""
    policy: Path | None = None
    reference: Literal["truth", "base"] = "truth"
    """`base`: logs have no labels, the base's results stand for truth."""


def open_side(path: Path) -> Side:
    """Open a run, a suite, or a baseline. Raises ConfigError where there is nothing. Raises RunError where it can't be
    read.
    """
    if not path.is_file():
        return open_results(path)
    kept = load_baseline(path)
    return Side(path, kept, len(kept) > 1)


def compare_sides(request: CompareRequest) -> Comparison:
    """Compare two runs or suites and judge them, or two folders of `check_relations`: then relations come first, and
    what was replayed of the log as it is. Raises ConfigError where a path or the policy isn't as expected.
    Raises RunError where a run can't be read. Raises MetricError where the two show different things, were scored by
    other rules, or measured nothing.
    """
    if not all((folder / RELATIONS_FILE).is_file() for folder in (request.base, request.head)):
        return _compare_results(request)
    originals = replace(request, base=request.base / ORIGINAL, head=request.head / ORIGINAL)
    found = _compare_results(originals)
    names = (found.rows[0].pipeline, found.rows[0].condition) if found.rows else ("", "")
    rows = compare_relations(request.base, request.head, *names)
    state: State = "failed" if any(row.verdict == "REGRESSED" for row in rows) else found.state
    return replace(found, rows=(*rows, *found.rows), state=state)


def _compare_results(request: CompareRequest) -> Comparison:
    policy = None if request.policy is None else load_policy(request.policy)
    rules = default_rules(request.tolerance) if policy is None else tuple(table.rule() for table in policy.gate)
    base, head = open_side(request.base), open_side(request.head)
    pairs, lacking, notes = pair_cells(base, head)
    if not pairs:
        raise MetricError(f"nothing to compare: no cell has a run in both ({'; '.join(lacking[:3] or notes[:3])})")
    for pair in pairs:
        several = f"{pair.name}: " if len(pairs) > 1 else ""
        notes += [f"{several}{note}" for note in pair.notes]
    notes += _compare_hosts(pairs)
    if request.reference == "base":
        from fbench.metrics.comparison.reference import compare_by_base

        return compare_by_base(pairs, tuple(notes), tuple(lacking))
    how = ErrorRates() if policy is None else ErrorRates(policy.alpha)
    rows, unused = Judge(rules, how, policy is None or policy.inform).judge(pairs)
    written = policy is not None and "gate" in policy.model_fields_set  # The default gates may fit nothing
    failures = [f"no number fits the gate of {_describe(rule)}, or none has a value" for rule in unused if written]
    failures += [*_over_budget(policy or Policy(version=1), pairs, lacking, is_default=policy is None)]
    if policy is not None and policy.latency is not None:
        table = policy.latency
        failures += compare_repeats(
            [_times(p, table.stage) for p in pairs], table.stage, table.max_ratio, table.min_repeats
        )
    objects: list[ObjectChange] = []
    worst: list[WorstFrame] = []
    for pair in pairs:
        changed, frames = find_changes(pair)
        objects, worst = objects + changed, worst + frames
    objects.sort(key=lambda change: (-change.num_frames, change.cell, change.from_s))
    worst.sort(key=lambda frame: (frame.base_errors - frame.head_errors, frame.cell, frame.frame))
    divergences = tuple(found for pair in pairs if (found := find_divergence(pair)) is not None)
    state = _state(rows, failures, all(pair.is_identical for pair in pairs), policy)
    first = tuple(objects[:_MOST_OBJECTS])
    all_notes = tuple(failures), tuple(notes)
    cells = tuple(pair.entry for pair in pairs)
    return Comparison(
        tuple(rows), request.tolerance, state, *all_notes, divergences, first, tuple(worst[:10]), cells=cells
    )


def _describe(rule: Rule) -> str:
    names = (rule.metric, rule.class_, rule.slice, rule.condition, rule.pipeline)
    return ", ".join(name for name in names if name != "*")


def _state(rows: Sequence[Row], failures: Sequence[str], is_identical: bool, policy: Policy | None) -> State:
    gating = [row for row in rows if row.gate]
    if failures or any(row.verdict == "REGRESSED" for row in gating):
        return "failed"
    if is_identical:
        return "identical"
    if any(row.verdict == "INCONCLUSIVE" for row in gating):
        return "failed" if policy is not None and policy.inconclusive == "fail" else "inconclusive"
    return "passed"


def _over_budget(policy: Policy, pairs: Sequence[CellPair], lacking: Sequence[str], is_default: bool) -> list[str]:
    budget, found = policy.budget, list[str]()
    if len(lacking) > budget.failed_cells:
        found += lacking
    for pair in pairs:
        head = pair.head
        coverage = next((s.value for s in head.scores if s.metric == "coverage"), None)
        if budget.min_coverage and (coverage is None or coverage < budget.min_coverage):
            found.append(f"{pair.name}: coverage {coverage} is below {budget.min_coverage:g}")
        if not is_default and not head.manifest.complete and not budget.incomplete:
            found.append(f"{pair.name}: head is incomplete: data was lost beyond its fault budget")
    runs = [pair.head.run for pair in pairs if pair.head.run is not None]
    if budget.failed_frames is not None:
        num = sum(frame.failed is not None for run in runs for frame in run.frames)
        if num > budget.failed_frames:
            found.append(f"the pipeline failed in {format_count(num, 'frame')}, {budget.failed_frames} may")
    if budget.faults:
        counts: dict[str, int] = {}
        for run in runs:
            for row in run.json("faults.json")["rows"]:
                counts[row["code"]] = counts.get(row["code"], 0) + int(row["count"])
        over = ((code, counts.get(code, 0), most) for code, most in budget.faults.items())
        found += [f"{format_count(num, 'fault')} {code}, {most} may be" for code, num, most in over if num > most]
    return found


def _compare_hosts(pairs: Sequence[CellPair]) -> list[str]:
    """Say in a line why latencies of base and head can't be compared, where the runs tell of their hosts."""
    reasons: dict[str, None] = {}
    for pair in pairs:
        runs = [side.run for side in (pair.base, pair.head) if side.run is not None]
        hosts = [run.json("host.json") for run in runs if (run.folder / "host.json").is_file()]
        if len(hosts) == 2 and all(isinstance(host, dict) for host in hosts):
            reasons |= dict.fromkeys(compare_hosts(*hosts))
    return [f"latencies can't be compared: {'; '.join(reasons)}"] if reasons else []


def _times(pair: CellPair, stage: str) -> tuple[tuple[list[int], object], tuple[list[int], object]]:
    """Times of a stage and the host, of both sides."""
    sides = []
    for side in (pair.base, pair.head):
        if side.run is None:
            raise MetricError(
                f"{pair.name}: a baseline file holds no times; compare latency with a suite that ran beside it"
            )
        host = side.run.json("host.json")
        sides.append((side.run.timings.get(stage, []), (host.get("cpu"), host.get("cores"), host.get("platform"))))
    return sides[0], sides[1]
