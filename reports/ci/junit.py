"""JUnit XML, as Jenkins, GitLab, GitHub actions and others read it: a test for each number that gates."""

from xml.etree import ElementTree

from fbench.replay.data.comparison import Comparison, Row


def junit(comparison: Comparison) -> str:
    """Return a document: a suite for each pipeline and condition, and one for budgets. Nothing measured is a failure;
    an inconclusive number is skipped, or fails where the policy says so.
    """
    root = ElementTree.Element("testsuites", name="fbench compare")
    groups: dict[str, list[Row]] = {}
    for row in comparison.gating:
        groups.setdefault(f"{row.pipeline} ({row.condition})", []).append(row)
    fails_open = comparison.state == "failed" and not comparison.failures
    fails_open &= not any(row.verdict == "REGRESSED" for row in comparison.gating)
    for name, rows in groups.items():
        suite = _add_suite(root, name, len(rows))
        for row in rows:
            test = f"{row.metric} of {row.class_}, {row.slice}, {row.matching}"
            case = ElementTree.SubElement(suite, "testcase", name=_clean(test), classname=_clean(name), time="0")
            said = f"{row.verdict}: {row.values}; {row.reason}"
            if row.verdict == "REGRESSED" or (row.verdict == "INCONCLUSIVE" and fails_open):
                _count(suite, "failures")
                failure = ElementTree.SubElement(case, "failure", message=_clean(said), type=row.verdict)
                failure.text = _clean(_details(comparison, row))
            elif row.verdict in ("INCONCLUSIVE", "null", "new"):
                _count(suite, "skipped")
                ElementTree.SubElement(case, "skipped", message=_clean(said))
    suite = _add_suite(root, "budgets", max(len(comparison.failures), 1))
    for failure_text in comparison.failures:
        case = ElementTree.SubElement(suite, "testcase", name=_clean(failure_text), classname="budgets", time="0")
        _count(suite, "failures")
        ElementTree.SubElement(case, "failure", message=_clean(failure_text), type="budget")
    if not comparison.failures:
        ElementTree.SubElement(suite, "testcase", name="all are kept", classname="budgets", time="0")
    for count in ("tests", "failures"):
        root.set(count, str(sum(int(suite.get(count, "0")) for suite in root)))
    ElementTree.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_suite(root: ElementTree.Element, name: str, num: int) -> ElementTree.Element:
    counts = {"tests": str(num), "failures": "0", "errors": "0", "skipped": "0", "time": "0"}
    return ElementTree.SubElement(root, "testsuite", {"name": _clean(name), **counts})


def _count(suite: ElementTree.Element, what: str) -> None:
    suite.set(what, str(int(suite.get(what, "0")) + 1))


def _details(comparison: Comparison, row: Row) -> str:
    lines = [f"gate: {row.gate}"]
    if row.low is not None and row.high is not None:
        lines.append(f"95 % interval of the change: {row.low:+.4f} to {row.high:+.4f} ({row.num_units} units)")
    places = comparison.places
    divergences, objects = comparison.changes_of(row)
    lines += [f"first difference: {places[found.cell]}{found}" for found in divergences[:3]]
    return "\n".join([*lines, *(f"{places[change.cell]}{change}" for change in objects[:10])])


def _clean(text: str) -> str:
    """What XML can hold; names come from data."""
    return "".join(c if c.isprintable() or c == "\n" else " " for c in text)
