"""What `uoarm lock --check` found, in the forms that people, scripts and build servers read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree as ET

import uoarm
from uoarm._lock import LockFinding, LockOutcome
from uoarm.model import to_json, write_json

__all__ = ["FORMS"]

_RULES: Mapping[LockOutcome, tuple[str, str, str]] = {
    LockOutcome.BREAKS: ("breaks", "error", "Not every message fits any more."),
    LockOutcome.FITS_WITH_MAP: ("fits-with-a-map", "error", "Messages fit with a map only."),
    LockOutcome.UNDECIDED: ("undecided", "warning", "Whether messages fit cannot be decided."),
}


def _text(findings: list[LockFinding], _: Path) -> str:
    lines = []
    for finding in findings:
        if finding.changed:
            lines.append(_sentence(finding))
            lines += (f"    {line}" for line in finding.suggestion.splitlines())
    counts = Counter(finding.outcome for finding in findings)
    lines.append(", ".join(f"{kind.value}: {counts[kind]}" for kind in LockOutcome))
    return "\n".join(lines)


def _json(findings: list[LockFinding], _: Path) -> str:
    return write_json(to_json({"findings": findings}), indent=2)


def _github(findings: list[LockFinding], lock: Path) -> str:
    """Return annotations of a pull request, one for each line that does not fit as it is."""
    return "\n".join(
        f"::error file={lock}::"
        + "%0A".join([_sentence(finding), *finding.suggestion.splitlines()])
        for finding in _unfit(findings)
    )


def _junit(findings: list[LockFinding], _: Path) -> str:
    """Return a report of tests: a suite for each function, a case for each edge and port."""
    unfit = len(list(_unfit(findings)))
    root = ET.Element(
        "testsuites", name="uoarm lock", tests=str(len(findings)), failures=str(unfit), errors="0"
    )
    for function in dict.fromkeys(finding.function for finding in findings):
        own = [finding for finding in findings if finding.function == function]
        failures = str(len(list(_unfit(own))))
        suite = ET.SubElement(
            root, "testsuite", name=function, tests=str(len(own)), failures=failures, errors="0"
        )
        for finding in own:
            case = ET.SubElement(suite, "testcase", classname=function, name=finding.subject)
            if finding.outcome is not LockOutcome.FITS:
                kind = _RULES[finding.outcome][0]
                report = ET.SubElement(case, "failure", type=kind, message=_sentence(finding))
                report.text = "\n".join([_sentence(finding), finding.suggestion]).rstrip()
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode")


def _sarif(findings: list[LockFinding], lock: Path) -> str:
    """Return a log of static analysis, version 2.1.0."""
    rules = [
        {"id": name, "shortDescription": {"text": text}, "defaultConfiguration": {"level": level}}
        for name, level, text in _RULES.values()
    ]
    driver = {"name": "uoarm lock", "semanticVersion": uoarm.__version__, "rules": rules}
    place = lock.as_uri() if lock.is_absolute() else quote(lock.as_posix())
    run = {
        "tool": {"driver": driver},
        "columnKind": "unicodeCodePoints",
        "results": [_result(finding, place) for finding in _unfit(findings)],
    }
    log = {
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [run],
    }
    return write_json(log, indent=2)


def _result(one: LockFinding, place: str) -> dict[str, Any]:
    name, level, _ = _RULES[one.outcome]
    location = {"artifactLocation": {"uri": place}, "region": {"startLine": 1}}
    logical = {"name": one.subject, "fullyQualifiedName": f"{one.function}: {one.subject}"}
    return {
        "ruleId": name,
        "ruleIndex": [rule[0] for rule in _RULES.values()].index(name),
        "level": level,
        "message": {"text": "\n".join([_sentence(one), one.suggestion]).rstrip()},
        "locations": [{"physicalLocation": location, "logicalLocations": [logical]}],
        # What it is about, not how it is worded, makes it the finding that was seen before.
        "partialFingerprints": {"subject/v1": f"{one.function}/{one.subject}/{one.path}"},
    }


def _unfit(findings: Iterable[LockFinding]) -> Iterable[LockFinding]:
    return (finding for finding in findings if finding.outcome is not LockOutcome.FITS)


def _sentence(one: LockFinding) -> str:
    text = f"{one.function}: {one.subject}: {one.outcome.value}"
    if not one.sentence:
        return text
    return f"{text}: {f'{one.path}: ' if one.path else ''}{one.sentence}"


FORMS: Mapping[str, Callable[[list[LockFinding], Path], str]] = {
    "text": _text, "json": _json, "github": _github, "junit": _junit, "sarif": _sarif,
}  # fmt: skip
"""Writers by the name of the form: from findings and the lock's file to text."""
