"""How well relations hold in two versions of a pipeline."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fbench.replay.contracts.errors import RunError, first_wrong
from fbench.replay.data.comparison import Row, Verdict

RELATIONS_FILE, ORIGINAL = "relations.json", "original"
"""What a folder of kept runs holds: a summary, and the run of the log as it is."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class KeptRelation(_Strict):
    """What became of one relation, as it is kept in a file."""

    relation: Annotated[str, Field(min_length=1, max_length=100)]
    least: Annotated[float, Field(ge=0, le=1)]
    agreement: Annotated[float, Field(ge=0, le=1)] | None
    violated: bool
    reason: str


class KeptRelations(_Strict):
    """The content of `RELATIONS_FILE`."""

    format: Literal[1]
    relations: list[KeptRelation]


def compare_relations(base: Path, head: Path, pipeline: str, condition: str) -> list[Row]:
    """Compare how well relations hold in two folders that `check_relations` kept, largest fall first. A relation that
    holds in the base and not in the head is a regression. Raises RunError where one of them can't be read.
    """
    before, after = ({own.relation: own for own in _read_kept(folder)} for folder in (base, head))
    rows = []
    for name, own in after.items():
        old = before.get(name)
        one, two = None if old is None else old.agreement, own.agreement
        verdict, reason = _judge(old, own)
        delta = None if one is None or two is None else two - one
        names = pipeline, condition, "agreement", "any", f"relation {name}", "with the original", "1"
        rows.append(Row(*names, one, two, delta, verdict, f"relation, at least {own.least:g}", reason))
    for name in (name for name in before if name not in after):
        names = pipeline, condition, "agreement", "any", f"relation {name}", "with the original", "1"
        how = f"relation, at least {before[name].least:g}"
        rows.append(Row(*names, before[name].agreement, None, None, "REGRESSED", how, "nothing was measured in head"))
    return sorted(rows, key=lambda row: (row.verdict != "REGRESSED", row.delta or 0.0, row.slice))


def _judge(old: KeptRelation | None, own: KeptRelation) -> tuple[Verdict, str]:
    if old is None or (old.agreement is None and not old.violated):
        return ("REGRESSED" if own.violated else "new"), own.reason or "only head tried it"
    if own.violated and not old.violated:
        return "REGRESSED", own.reason or "it doesn't hold any more"
    if old.violated and not own.violated:
        return "improved", "it holds now"
    if own.agreement is None and old.agreement is not None:
        return "REGRESSED", f"nothing was measured: {own.reason}"
    held = "violated before, too" if own.violated else "it holds"
    return ("same" if own.agreement == old.agreement else "changed"), held


def _read_kept(folder: Path) -> list[KeptRelation]:
    path = folder / RELATIONS_FILE
    try:
        return KeptRelations.model_validate_json(path.read_bytes()).relations
    except ValidationError as error:
        raise RunError(f"{path}: not a file of this version of fbench ({first_wrong(error)})") from error
    except OSError as error:
        raise RunError(f"{path}: can't be read ({error.strerror})") from error
