"""Accessibility of the dashboard, as axe-core finds it in a real Chromium.

npm brings axe-core, unless UOARM_AXE names a folder in which `npm install axe-core@4` was run.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.harness._shared import made_once
from tests.server.browser import Browser, says
from tests.server.conftest import Connect, Visit
from tests.server.shown import front, shown_robot

from uoarm import RobotManager

pytestmark = pytest.mark.needs("chromium")

# What a person looks at, by its address, and what is there once it is drawn.
VIEWS = {
    "": '[data-card="function/camera"], .list .item',
    "#/list": ".list .item",
    "#/timeline": ".timeline .event",
    "#/configuration": ".found-bridge",
    "#/graph/function/camera&function/hopeless/explain&function/drive/use": ".form .button.main",
    "#/list/function/faces&function/echo/use": ".form .button.main",
}
# Transitions end first: half of one has colours that no one reads.
FINDINGS = """
Promise.all(document.getAnimations().map((animation) => animation.finished.catch(() => null)))
  .then(() => axe.run(document, { resultTypes: ["violations"] }))
  .then(({ violations }) => violations
    .filter(({ impact }) => impact === "serious" || impact === "critical")
    .flatMap(({ id, nodes }) => nodes.map(({ target, failureSummary }) =>
      `${id}: ${target.join(" ")}: ${failureSummary}`)))
"""


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    with shown_robot() as robot:
        yield robot


@pytest.fixture(scope="session")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the source of axe-core."""
    given = os.environ.get("UOARM_AXE")
    folder = Path(given) if given else made_once(tmp_path_factory, "axe", _fetch)
    return (folder / "node_modules/axe-core/axe.min.js").read_text(encoding="utf-8")


def _fetch(folder: Path) -> None:
    if shutil.which("npm") is None:
        pytest.skip("needs npm: apt install npm")
    options = ["--prefix", str(folder), "--no-audit", "--no-fund", "--ignore-scripts", "--silent"]
    if subprocess.run(["npm", "install", *options, "axe-core@4"], check=False).returncode:
        pytest.skip("npm cannot fetch axe-core")


def findings(browser: Browser, axe: str) -> list[str]:
    """Return what axe-core calls serious or critical in the page as it is."""
    if not browser.js("window.axe !== undefined"):
        browser.js(f"{axe};0")
    found: list[str] = browser.js(FINDINGS)
    return found


def light_and_dark(browser: Browser, width: int, height: int) -> Iterator[str]:
    """Show the page as it is in one scheme of colours after the other, of which only CSS knows."""
    for scheme in ("light", "dark"):
        browser.show(width, height, phone=width < 700, dark=scheme == "dark")
        yield scheme


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
def test_nothing_serious_is_found(
    browser: Browser, visit: Visit, talk: Connect, axe: str, width: int, height: int
) -> None:
    browser.show(width, height, phone=width < 700)
    client = talk()
    client.open("faces")
    front.take((9, 9, 9))
    found = {}
    for place, shown in VIEWS.items():
        visit(place)
        browser.until(f"document.querySelector({json.dumps(shown)})")
        for scheme in light_and_dark(browser, width, height):
            found[place, scheme] = findings(browser, axe)
    assert {place: those for place, those in found.items() if those} == {}


def test_axe_finds_what_is_wrong(browser: Browser, visit: Visit, axe: str) -> None:
    """The test above would see a serious finding."""
    visit()
    browser.js("document.body.append(document.createElement('button'))")
    assert [finding.partition(":")[0] for finding in findings(browser, axe)] == ["button-name"]


def test_nothing_serious_is_found_in_what_is_watched(
    browser: Browser, visit: Visit, axe: str
) -> None:
    visit("#/graph/function/camera/use")
    browser.click(".button.main", "Watch")
    browser.until(says(".panel", "No message yet"))
    front.take((250, 100, 3))
    browser.until("document.querySelector('.picture canvas')")
    assert findings(browser, axe) == []
