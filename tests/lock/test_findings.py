"""Findings as build servers read them: JUnit's reports and SARIF's logs."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree as ET

from uoarm._lock import LockFinding, LockOutcome
from uoarm.cli._lock import FORMS

LOCK = Path("robots/the cart/robot.lock")
FINDINGS = [
    LockFinding("scan", "laser.out -> map.in", LockOutcome.FITS, changed=False),
    LockFinding("scan", "output.default", LockOutcome.FITS, changed=True),
    LockFinding(
        "drive", "pad.out -> base.in", LockOutcome.FITS_WITH_MAP, changed=True, path="speed",
        sentence="the units differ: km/h & m/s", suggestion="map: {speed: {from: <speed>}}",
    ),
    LockFinding(
        "drive", "input.go", LockOutcome.UNDECIDED, changed=True, sentence="it took too long"
    ),
    LockFinding(
        "drive", "output.on", LockOutcome.BREAKS, changed=True, path="x", sentence="it is gone",
    ),
]  # fmt: skip


def test_a_report_of_tests_has_a_case_for_each_finding() -> None:
    root = ET.fromstring(FORMS["junit"](FINDINGS, LOCK))
    assert (root.get("tests"), root.get("failures")) == ("5", "3")
    suites = [
        (element.get("name"), element.get("tests"), element.get("failures")) for element in root
    ]
    assert suites == [("scan", "2", "0"), ("drive", "3", "3")]
    failed = {case.get("name"): case[0] for case in root.iter("testcase") if len(case)}
    assert [element.get("type") for element in failed.values()] == [
        "fits-with-a-map", "undecided", "breaks",
    ]  # fmt: skip
    report = failed["pad.out -> base.in"]
    assert "speed: the units differ: km/h & m/s" in str(report.get("message"))
    assert str(report.text).endswith("map: {speed: {from: <speed>}}")


def test_a_log_of_static_analysis_has_a_result_for_what_does_not_fit() -> None:
    log = json.loads(FORMS["sarif"](FINDINGS, LOCK))
    (run,) = log["runs"]
    rules = [rule["id"] for rule in run["tool"]["driver"]["rules"]]
    reports = [(result["ruleId"], result["level"]) for result in run["results"]]
    assert reports == [("fits-with-a-map", "error"), ("undecided", "warning"), ("breaks", "error")]
    assert all(rules[result["ruleIndex"]] == result["ruleId"] for result in run["results"])
    (place,) = run["results"][0]["locations"]
    assert place["physicalLocation"]["artifactLocation"]["uri"] == "robots/the%20cart/robot.lock"
    assert "map: {speed" in run["results"][0]["message"]["text"]
    assert json.loads(FORMS["sarif"]([], LOCK.absolute()))["runs"][0]["results"] == []


def test_each_form_of_nothing_is_whole() -> None:
    assert len(ET.fromstring(FORMS["junit"]([], LOCK))) == 0
    assert FORMS["github"]([], LOCK) == ""
    assert FORMS["text"]([], LOCK).startswith("fits: 0")
