"""Other managers in the dashboard: groups that are folded, in a real Chromium."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.server.browser import CONTRAST, Browser, says, text
from tests.server.conftest import Connect, Visit
from tests.server.shown import END, front, manage
from tests.server.test_accessibility import axe, findings, light_and_dark

from uoarm import RobotManager
from uoarm.server import ServerOptions, serve_in_thread

__all__ = ["axe"]  # a fixture

ROBOT = """
version: 1
bridges: {python: {}}
export: {local: ["*"]}
functions:
  camera:
    {components: [{name: front, bridge: python, output: {endpoint: ["tests.server.shown:camera"]}}]}
  transport:
    {components: [{name: base, bridge: python, service: {endpoint: ["tests.server.shown:drive"]}}]}
"""
DESK = """
version: 1
bridges:
  python: {{}}
  robot3: {{plugin: remote, options: {{url: "{url}"}}}}
  robot4: {{plugin: remote, options: {{url: "{url}"}}}}
functions:
  camera3:
    {{components: [{{name: robot3_camera, bridge: robot3, output: {{endpoint: [camera]}}}}]}}
  drive3:
    {{components: [{{name: robot3_transport, bridge: robot3, service: {{endpoint: [transport]}}}}]}}
  drive4:
    {{components: [{{name: robot4_transport, bridge: robot4, service: {{endpoint: [transport]}}}}]}}
  echo:
    components:
      - name: echo
        bridge: python
        input: {{endpoint: ["tests.server.shown:echo"]}}
        output: {{endpoint: ["tests.server.shown:echo"]}}
"""
CARDS = "[...document.querySelectorAll('.card')].map((card) => card.dataset.card).sort().join()"
COVERED = """
(() => {
  const boxes = [...document.querySelectorAll('.card')].map((card) => card.getBoundingClientRect());
  const meet = (a, b) => a.x < b.right && b.x < a.right && a.y < b.bottom && b.y < a.bottom;
  return boxes.flatMap((a, at) => boxes.slice(at + 1).filter((b) => meet(a, b))).length;
})()
"""
THIRD, FOURTH = '[data-card="manager/robot3"]', '[data-card="manager/robot4"]'
pytestmark = [pytest.mark.needs("chromium"), pytest.mark.needs("remote")]


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    """Return a desk, whose robots are both one manager."""
    front.reset()
    with manage(ROBOT) as far, serve_in_thread(far, ServerOptions(port=0)) as server:
        with manage(DESK.format(url=f"ws://127.0.0.1:{server.ports[0]}/")) as desk:
            yield desk
        front.put(END)


def test_a_manager_is_one_card_and_what_it_gives_draws_its_edges_to_it(
    browser: Browser, visit: Visit, talk: Connect
) -> None:
    browser.show(1440, 900)
    talk().open("camera3")
    visit()
    browser.until(f"{CARDS} === 'connection/c1,function/echo,manager/robot3,manager/robot4'")
    browser.until(says(f"{THIRD}.is-ok", "2 functions, 1 connection in use"))
    browser.until(says(THIRD, "ws://127.0.0.1:"))
    browser.until(says(f"{FOURTH}.is-idle", "not connected yet"))  # nothing was asked of it
    browser.until("document.querySelectorAll('.edge.flows').length === 1")
    assert browser.js(COVERED) == 0
    browser.click(THIRD)
    browser.until("document.querySelectorAll('.card.function').length === 3")
    browser.until("document.querySelectorAll('.edge.holds').length === 2")
    browser.until("document.querySelectorAll('.edge.flows').length === 1")
    assert browser.js(COVERED) == 0
    assert browser.js("location.hash") == "#/graph&unfolded=robot3"
    assert not browser.js("document.querySelector('.panel')")


def test_it_is_as_bad_as_its_worst_part(browser: Browser, visit: Visit, talk: Connect) -> None:
    client = talk()
    client.open("camera3")
    visit()
    browser.until(says(f"{THIRD}.is-ok", "1 connection in use"))
    front.put(RuntimeError("the lens cap is on"))
    browser.until(says(f"{THIRD}.is-lost", "0 connections in use"))
    assert browser.js(text(f"{FOURTH}.is-idle"))


def test_keys_unfold_it_and_the_address_keeps_that(browser: Browser, visit: Visit) -> None:
    visit()
    browser.until(f"document.querySelector('{THIRD}')")
    title = "document.querySelector('[data-title=\"manager/robot3\"]')"
    browser.js(f"{title}.focus()")
    assert browser.js(f"{title}.getAttribute('aria-expanded')") == "false"
    browser.press("Enter")
    browser.until("document.querySelector('[data-card=\"function/camera3\"]')")
    assert browser.js(f"{title}.getAttribute('aria-expanded')") == "true"
    assert browser.js(f"document.activeElement === {title}")
    browser.press("ArrowRight")
    assert browser.js("document.activeElement.dataset.title").startswith("function/")
    browser.press("ArrowLeft")
    assert browser.js(f"document.activeElement === {title}")
    visit("#/graph&unfolded=robot3")
    browser.until("document.querySelector('[data-card=\"function/drive3\"]')")
    browser.js(f"{title}.focus()")
    browser.press("f")
    browser.until("!document.querySelector('[data-card=\"function/drive3\"]')")
    assert browser.js("location.hash") == "#/graph"


def test_what_is_searched_is_found_in_it(browser: Browser, visit: Visit) -> None:
    visit()
    browser.until(f"document.querySelector('{THIRD}')")
    browser.press("/")
    browser.write("robot3_camera")
    browser.until(f"{CARDS} === 'function/camera3,manager/robot3'")


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
def test_nothing_serious_is_found(
    browser: Browser, visit: Visit, axe: str, width: int, height: int
) -> None:
    browser.show(width, height, phone=width < 700)
    for place in ("#/graph", "#/graph&unfolded=robot3,robot4"):
        visit(place)
        browser.until(says(THIRD, "2 functions"))
        for _ in light_and_dark(browser, width, height):
            assert findings(browser, axe) == []  # first, as it waits for transitions
            assert browser.js(COVERED) == 0
            assert browser.js(CONTRAST) == []
            assert browser.js("document.documentElement.scrollWidth") <= width
