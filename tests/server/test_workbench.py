"""The dashboard as a workbench, in a real Chromium: panels, plots, pictures with overlays."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.server.browser import Browser, says
from tests.server.conftest import Visit
from tests.server.shown import END, SHOWN, front
from tests.server.test_dashboard import manage

from uoarm import RobotManager

pytestmark = pytest.mark.needs("chromium")

PANELS = "[...document.querySelectorAll('.panel')].map((panel) => panel.dataset.panel).join(' ')"
# Cards that a panel, a button or the edge of the graph covers in part.
COVERED = """
(() => {
  const room = document.querySelector(".stage").getBoundingClientRect();
  const others = [...document.querySelectorAll(".panel, .graph-tools, .graph-help, .top, .summary")]
    .map((other) => other.getBoundingClientRect()).filter((box) => box.width > 0);
  return [...document.querySelectorAll(".card")].filter((card) => {
    const box = card.getBoundingClientRect();
    const outside = box.left < room.left || box.right > room.right
      || box.top < room.top || box.bottom > room.bottom;
    return outside || others.some((other) => box.left < other.right && other.left < box.right
      && box.top < other.bottom && other.top < box.bottom);
  }).map((card) => card.dataset.card);
})()
"""


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    front.reset()
    manager = manage(SHOWN)
    yield manager
    front.put(END)
    manager.close()


class TestPanels:
    """Several at once."""

    def test_what_is_opened_replaces_what_is_not_kept_and_the_address_restores_all(
        self, browser: Browser, visit: Visit
    ) -> None:
        visit()
        browser.click('[data-card="function/camera"]')
        browser.until(f"{PANELS} === 'function/camera'")
        browser.click('[data-card="function/echo"]')
        browser.until(f"{PANELS} === 'function/echo'")
        browser.click('.panel [aria-label="Keep open"]')
        browser.until("document.querySelector('.panel-tools [aria-pressed=true]')")
        browser.click('[data-card="function/drive"]')
        browser.until(f"{PANELS} === 'function/echo function/drive'")
        browser.click('[data-card="function/camera"]', shift=True)
        browser.until(f"{PANELS} === 'function/echo function/drive function/camera'")
        assert browser.js("document.querySelectorAll('.card.selected').length") == 3
        browser.click('[data-panel="function/drive"] .tabs a', "Call")
        browser.until(says('[data-panel="function/drive"]', "hurry"))
        place = browser.js("location.hash")
        browser.command("Page.reload")
        browser.until(f"{PANELS} === 'function/echo function/drive function/camera'")
        browser.until(says('[data-panel="function/drive"]', "hurry"))
        assert browser.js("location.hash") == place
        browser.click(".dock-head .button", "Close all")
        browser.until("!document.querySelector('.panel') && !location.hash.includes('&')")

    def test_they_are_moved_and_closed_by_keyboard(self, browser: Browser, visit: Visit) -> None:
        visit("#/graph/function/camera&function/echo&connection/c9")
        browser.until(f"{PANELS} === 'function/camera function/echo connection/c9'")
        browser.js("document.querySelector('[data-panel=\"function/echo\"] h2').focus()")
        browser.press("[")
        browser.until(f"{PANELS} === 'function/echo function/camera connection/c9'")
        assert browser.js("document.activeElement.textContent") == "echo"
        browser.press("]")
        browser.press("]")
        browser.until(f"{PANELS} === 'function/camera connection/c9 function/echo'")
        browser.press("Escape")
        browser.until(f"{PANELS} === 'function/camera connection/c9'")
        browser.until("document.activeElement.dataset.title === 'function/echo'")
        browser.js("document.querySelector('.divider').focus()")
        wide = "document.querySelector('.dock').clientWidth"
        before = browser.js(wide)
        browser.press("ArrowLeft")
        browser.until(f"{wide} > {before} + 20")
        assert "dock=" in browser.js("location.hash")

    @pytest.mark.parametrize("width", [1440, 1024])
    def test_no_card_is_covered_and_cards_stay_where_they_are(
        self, browser: Browser, visit: Visit, width: int
    ) -> None:
        places = "[...document.querySelectorAll('.card')].map((card) => card.style.cssText).join()"
        browser.show(width, 900)
        visit()
        browser.until("document.querySelectorAll('.card.function').length === 5")
        assert browser.js(COVERED) == []
        before = browser.js(places)
        for name in ("camera", "echo", "drive"):
            browser.click(f'[data-card="function/{name}"]', shift=True)
            browser.until(says(f'[data-panel="function/{name}"]', name))
            browser.until(f"({COVERED}).length === 0")
            assert browser.js(places) == before

    def test_a_phone_shows_them_one_below_the_other(self, browser: Browser, visit: Visit) -> None:
        browser.show(390, 844, phone=True)
        visit("#/list/function/camera&function/echo/use")
        browser.until("document.querySelectorAll('.panel').length === 2")
        assert browser.js("document.documentElement.scrollWidth") == 390
        browser.click('[data-panel="function/echo"] [aria-label="Close (Escape)"]')
        browser.until(f"{PANELS} === 'function/camera'")
