"""Findings of a check: codes, how serious they are, and what to do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.contracts.faults import FAULTS

Severity = Literal["error", "warning", "info"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "info")


class Rule(NamedTuple):
    """One kind of finding."""

    severity: Severity
    advice: str
    what: str = ""  # Empty where the fault table says it


RULES: Mapping[str, Rule] = {
    "LOG002": Rule("error", "record again, or replay what is there with --on-fault tolerant"),
    "LOG003": Rule("warning", "fbench log convert writes a log with an index, which opens faster"),
    "LOG004": Rule("error", "copy the file again from where it was recorded; what is damaged is skipped"),
    "LOG005": Rule("warning", "copy the file again from where it was recorded; all messages are whole"),
    "LOG006": Rule("warning", "record with checksums; fbench log convert adds them for the future"),
    "LOG008": Rule("error", "record again with all channels and schemas in the file"),
    "LOG010": Rule("warning", "name topics in UTF-8; the bytes are shown as \\xff"),
    "LOG011": Rule("error", "copy the whole recording"),
    "LOG012": Rule("info", "nothing, if these topics aren't needed"),
    "LOG013": Rule("warning", "read it with --decoder and a decoder plug-in, see docs/plugins.md; if nothing is missed "
                   "without it, --ignore LOG013"),
    "PQ002": Rule("error", "copy the folder again from where it was written; what is damaged is skipped"),
    "DEC001": Rule("error", "look at the program that wrote the message; it is skipped"),
    "DEC002": Rule("error", "look at the camera's driver; the image can't be decoded as it should"),
    "DEC003": Rule("error", "look at the program that wrote the cloud; it is skipped"),
    "DEC004": Rule("error", "look for a full network or a slow recorder; a shorter interval of keyframes loses less"),
    "DEC005": Rule("info", "nothing: a recording rarely begins with a keyframe"),
    "DEC006": Rule("info", "nothing; record H.264, H.265, or AV1 with order hints, which number their pictures"),
    "DAT001": Rule("error", "look at the sensor's driver; these clouds are skipped"),
    "DAT002": Rule("warning", "look at the sensor: was it covered or starting up?"),
    "DAT003": Rule("warning", "look whether the sensor gives meters"),
    "DAT004": Rule("warning", "drop such points when recording; fbench drops them when replaying"),
    "DAT005": Rule("error", "look at the localization that wrote it"),
    "DAT006": Rule("warning", "let the driver write NaN for what it didn't measure"),
    "LIM003": Rule("error", "record the calibration of this image size"),
    "CAL001": Rule("error", "record the calibration, let fbench init write an fbench.toml that says how to add it, or "
                   "leave the sensor out with --topics '!NAME'"),
    "CAL002": Rule("info", "nothing, if the calibration was meant to change; trackers start afresh"),
    "TIM001": Rule("warning", "stamp messages in the order of measurement; fbench drops those that run back"),
    "TIM003": Rule("warning", "look at the driver: one sensor can't measure twice at once",
                   "two messages of a sensor have the same stamp"),
    "TIM004": Rule("warning", "look for two recorders or publishers of one topic", "a message appears twice"),
    "TIM005": Rule("warning", "look for a clock that was set, or a recording that was played in a loop"),
    "TIM007": Rule("warning", "look for a full disk or network; trackers start afresh behind a gap of the reference"),
    "TIM008": Rule("error", "synchronize the clocks, or give --offset SENSOR=MS or --stamps log",
                   "a sensor's clock differs from the reference sensor's by more than a minute"),
    "TIM009": Rule("warning", "look at the sensor's latency and clock; raise --timeout-ms if frames lack it",
                   "header stamps are more than two periods older than the arrival times, or more than 20 ms newer"),
    "TIM011": Rule("warning", "let the driver stamp its messages"),
    "TIM012": Rule("warning", "give --offset SENSOR=MS",
                   "with other stamps, a sensor's points would fit the truth boxes clearly better"),
    "TIM013": Rule("warning", "let the driver write times as ns after the stamp; the points count as measured at once"),
    "FRM001": Rule("error", "look at its clock, rate and latency; a replay that needs it ends with 4",
                   "hardly any frame has a sensor; only information if the pipeline doesn't use it"),
    "GT001": Rule("info", "nothing, if no scores are needed", "no ground truth"),
    "GT003": Rule("error", "give every object of a frame its own id", "two boxes of one frame have the same id"),
    "GT004": Rule("error", "repair or remove these boxes", "a box isn't finite or has no size"),
    "GT006": Rule("warning", "choose the sensor that was labeled with --reference"),
    "GT008": Rule("error", "keep the boxes that matter; a frame with more isn't scored", "a frame has too many boxes"),
    "PRD002": Rule("error", "repair the pipeline"),
    # Codes that only a check reports.
    "CHK001": Rule("error", "let the driver stamp its messages", "stamps are 0"),
    "CHK002": Rule("warning", "look at the sensor's trigger; frames by nearest stamp may lack it",
                   "more than a tenth of the periods are irregular"),
    "CHK003": Rule("warning", "look for a full network or a slow recorder",
                   "messages were lost; only information if at most a twentieth of them"),
    "CHK004": Rule("info", "nothing; fbench puts messages in order of their log times",
                   "messages aren't in the order of their log times"),
    "CHK005": Rule("warning", "look whether the sensor was on and its topic recorded",
                   "a sensor of the rig has no messages; only information if the log contains only boxes"),
    "CHK007": Rule("error", "record a LiDAR, camera or radar",
                   "there are no messages of sensors and no boxes, so there are no frames"),
    "CHK008": Rule("error", "choose another pipeline, or record what it needs", "the pipeline can't start on this rig"),
    "CHK009": Rule("warning", "look why these messages are missing",
                   "frames lack a sensor; only information if the pipeline doesn't use it"),
    "CHK010": Rule("info", "nothing: a sensor that is faster than the reference has messages to spare",
                   "some messages belong to no frame"),
}  # fmt: skip
"""By code: those of the fault table where one fits, `CHK...` where a check alone finds it."""


@dataclass(frozen=True)
class Finding:
    """Something about a log that its user should know."""

    code: str
    severity: Severity
    source: str  # Sensor or topic; empty: the log
    text: str
    count: int
    first: str  # Where it was met first; empty: everywhere
    advice: str


def finding(
    code: str, source: str, text: str, count: int = 1, first: str = "", severity: Severity | None = None,
    advice: str | None = None,
) -> Finding:  # fmt: skip
    """Make a finding; severity and advice are those of its code unless given."""
    rule = rule_of(code)
    return Finding(code, severity or rule.severity, source, text, count, first, advice or rule.advice)


def rule_of(code: str) -> Rule:
    """Return the rule of a code; one that only the fault table has is as serious as its behaviour."""
    if code in RULES:
        return RULES[code]
    return Rule("warning" if FAULTS[code].behaviour == "degrade" else "error", "see docs/faults.md")


def require_codes(codes: Sequence[str]) -> None:
    """Accept only codes that a finding can have. Raises ConfigError for another one."""
    known = sorted({**RULES, **FAULTS})
    for code in codes:
        if code not in known:
            raise ConfigError(f"--ignore {code}: no such finding{did_you_mean(code, known)}")
