"""The dashboard as a workbench, in a real Chromium: panels, plots, pictures with overlays."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.server.browser import Browser, says
from tests.server.conftest import Between, Connect, Serve, Visit
from tests.server.serving import access_file
from tests.server.shown import front, shown_robot
from tests.server.talk import Talk
from tests.server.test_dashboard import GUEST

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.model import Health, QueuePolicy
from uoarm.server import Server, hash_token
from uoarm.testing import MemoryBridge, patience, wait

pytestmark = pytest.mark.needs("chromium")

PLACE = """
((box) => [box.x, box.y, box.width, box.height])(
  document.querySelector("?").getBoundingClientRect())
"""
PANELS = "[...document.querySelectorAll('.panel')].map((panel) => panel.dataset.panel).join(' ')"
BUTTONS = """
JSON.stringify([...document.querySelectorAll(".panel button")].map((button) => {
  const { x, y } = button.getBoundingClientRect();
  return [button.textContent.trim(), x, y];
}))
"""
# Whether something is written or drawn at the numbers of a plot's axis, above those of the time.
MARKS = """
((canvas) => canvas && canvas.getContext("2d").getImageData(0, 0, 50, canvas.height / 2).data
  .some((value) => value > 0))(document.querySelector(".plot canvas"))
"""
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
    with shown_robot() as robot:
        yield robot


SENSES = """
version: 1
bridges: {memory: {plugin: python}}
functions:
  speed: {components: [{name: speed, bridge: memory, output: {endpoint: [speed]}}]}
  camera: {components: [{name: camera, bridge: memory, output: {endpoint: [camera]}}]}
  faces: {components: [{name: faces, bridge: memory, output: {endpoint: [faces]}}]}
  eye: {components: [{name: eye, bridge: memory, output: {endpoint: [eye]}}]}
  found: {components: [{name: found, bridge: memory, output: {endpoint: [found]}}]}
  laser: {components: [{name: laser, bridge: memory, output: {endpoint: [laser]}}]}
  map: {components: [{name: map, bridge: memory, output: {endpoint: [map]}}]}
"""
NUMBER = {"type": "number"}
COUNT = {"type": "object", "required": ["n"], "properties": {"n": {"type": "integer"}}}


def record_of(**properties: object) -> dict[str, object]:
    return {"type": "object", "required": [*properties], "properties": properties}


class Senses(MemoryBridge):
    """Numbers, pictures, boxes in them, a scan and a map, as a test sends them."""

    def __init__(self) -> None:
        super().__init__()
        whole, numbers = {"type": "integer"}, {"type": "array", "items": NUMBER}
        box = record_of(x=whole, y=whole, width=whole, height=whole, name={"type": "string"})
        stamp = record_of(sec=whole, nanosec=whole)
        pixels = {
            "width": whole,
            "height": whole,
            "encoding": {"const": "rgb8"},
            "data": {
                "type": "array",
                "items": {"type": "integer", "minimum": 0, "maximum": 255},
                "x-octets": True,
            },
        }
        kinds = {
            "eye": record_of(stamp=stamp, **pixels),
            "found": record_of(stamp=stamp, faces={"type": "array", "items": box}),
            "speed": record_of(forward={**NUMBER, "x-unit": "m/s"}, turn=NUMBER, still=NUMBER),
            "camera": record_of(**pixels),
            "faces": record_of(faces={"type": "array", "items": box}),
            "laser": record_of(
                angle_min=NUMBER, angle_max=NUMBER, angle_increment=NUMBER, ranges=numbers
            ),
            "map": record_of(
                info=record_of(width=whole, height=whole, resolution=NUMBER),
                data={"type": "array", "items": whole},
            ),
        }
        self.of = {name: self.emitter(name, schema) for name, schema in kinds.items()}


class TestSenses:
    """What is drawn of a message."""

    @pytest.fixture
    def senses(self) -> Senses:
        return Senses()

    @pytest.fixture
    def robot(self, senses: Senses) -> Iterator[RobotManager]:
        given = {"memory": senses}
        with RobotManager(loads(SENSES), registry=Registry(()), bridges=given) as robot:
            yield robot

    def watch(self, browser: Browser, name: str) -> None:
        panel = f'[data-panel="function/{name}"]'
        browser.until(f"document.querySelector('{panel} .bar select')")
        browser.js(
            "(s => { s.value = '0'; s.dispatchEvent(new Event('change', { bubbles: true })); })"
            f"([...document.querySelectorAll('{panel} .bar select')].at(-1))"
        )
        browser.click(f"{panel} .button.main", "Watch")
        browser.until(says(panel, "No message yet"))

    def overlay(self, browser: Browser, name: str) -> None:
        browser.js(
            f"(s => {{ s.value = '{name}';"
            "s.dispatchEvent(new Event('change', { bubbles: true })); })"
            "([...document.querySelectorAll('.panel .bar label')]"
            ".find((label) => label.textContent.startsWith('Overlay')).querySelector('select'))"
        )

    def test_numbers_are_plotted_by_unit_with_values_under_the_cursor(
        self, browser: Browser, visit: Visit, senses: Senses
    ) -> None:
        visit("#/graph/function/speed/use")
        self.watch(browser, "speed")
        for number in range(5):
            senses.of["speed"].emit({"forward": number / 2, "turn": -number, "still": 1})
        plots = (
            "[...document.querySelectorAll('.plot')].map((plot) => plot.ariaLabel.split(';')[0])"
        )
        browser.until(f"{plots}.join() === 'Plot of forward in m/s,Plot of turn'")
        browser.until("document.querySelector('.plot .u-over')")
        browser.js("document.querySelector('.plot').focus()")
        browser.press("ArrowRight")
        browser.until(says(".plot .u-legend", "2 m/s"))
        browser.click(".fields summary")
        browser.click(".fields-list label", "still")
        browser.click(".fields-list label", "forward")
        browser.until(f"{plots}.join() === 'Plot of turn, still'")
        browser.click(".bar .button", "Pause")
        browser.until(says(".bar .button[aria-pressed=true]", "Resume"))
        browser.until("location.hash.includes('fields=turn%2Cstill')")
        assert browser.js("document.querySelector('.plot canvas').clientWidth") > 300

    @pytest.mark.parametrize("turn", [3.4e38, 1.7e308])
    def test_the_axis_of_very_large_numbers_has_marks(
        self, browser: Browser, visit: Visit, senses: Senses, turn: float
    ) -> None:
        visit("#/graph/function/speed/use")
        self.watch(browser, "speed")
        for number in range(5):
            senses.of["speed"].emit({"forward": 0, "turn": turn * (-1) ** number, "still": 1})
        browser.until(MARKS)
        browser.js("document.querySelector('.plot').focus()")
        browser.press("ArrowRight")
        browser.until(says(".plot .u-legend", f"{turn:.1e}"[:3]))

    def test_what_is_pressed_stays_where_it_is_as_a_cause_comes(
        self, browser: Browser, visit: Visit, robot: RobotManager, senses: Senses
    ) -> None:
        with robot.request("speed"):
            visit("#/graph/function/speed")
            browser.until(says(".panel-body", "Kill"))
            before = browser.js(BUTTONS)
            senses.report(Health.DEGRADED, "it is hot")
            browser.until(says(".panel-body", "it is hot"))
            assert browser.js(BUTTONS) == before

    def test_the_rate_of_a_port_has_three_figures_at_most(
        self, browser: Browser, visit: Visit, robot: RobotManager, senses: Senses
    ) -> None:
        with robot.request("speed"):
            for _ in range(9):
                senses.of["speed"].emit({"forward": 1.0, "turn": 0.0, "still": 0.0})
            visit("#/configuration")
            browser.until(says(".found", "output speed, 0 a second, used by speed"))

    def test_boxes_of_another_function_lie_over_a_picture(
        self, browser: Browser, visit: Visit, senses: Senses, robot: RobotManager
    ) -> None:
        visit("#/graph/function/camera/use")
        self.watch(browser, "camera")
        picture = {"width": 40, "height": 30, "encoding": "rgb8", "data": bytes(3600)}
        senses.of["camera"].emit(picture)
        browser.until("document.querySelector('.picture canvas')")
        self.overlay(browser, "faces")
        states = ["running", "running"]
        wait(lambda: [link.state.value for link in robot.status().connections] == states)
        senses.of["faces"].emit(
            {"faces": [{"x": 10, "y": 6, "width": 20, "height": 15, "name": "Ada"}]}
        )
        browser.until("document.querySelector('.shapes text')?.textContent === 'Ada'")
        left, top, wide, high = browser.js(PLACE.replace("?", ".picture canvas"))
        x, y, width, height = browser.js(PLACE.replace("?", ".shapes rect"))
        assert x == pytest.approx(left + wide / 4, abs=3)
        assert y == pytest.approx(top + high / 5, abs=3)
        assert width == pytest.approx(wide / 2, abs=6)
        assert height == pytest.approx(high / 2, abs=6)
        browser.click(".panel .button", "Stop")
        wait(lambda: robot.status().connections == ())

    def test_an_overlay_lies_over_the_picture_that_it_was_made_of(
        self, browser: Browser, visit: Visit, senses: Senses, robot: RobotManager
    ) -> None:
        shown = (
            "[document.querySelector('.picture canvas').getContext('2d')"
            ".getImageData(0, 0, 1, 1).data[0],"
            " document.querySelector('.shapes text')?.textContent ?? ''].join(' ')"
        )

        def take(second: int) -> None:
            senses.of["eye"].emit(
                {
                    "stamp": {"sec": second, "nanosec": 0},
                    "width": 4,
                    "height": 3,
                    "encoding": "rgb8",
                    "data": bytes([second]) * 36,
                }
            )

        def find(second: int) -> None:
            face = {"x": 1, "y": 1, "width": 2, "height": 1, "name": f"at {second}"}
            senses.of["found"].emit({"stamp": {"sec": second, "nanosec": 0}, "faces": [face]})

        visit("#/graph/function/eye/use")
        self.watch(browser, "eye")
        take(10)
        browser.until(f"document.querySelector('.picture canvas') && {shown} === '10 '")
        self.overlay(browser, "found")
        states = ["running", "running"]
        wait(lambda: [link.state.value for link in robot.status().connections] == states)
        for second in (11, 12, 13):
            take(second)
        browser.until(f"{shown} === '13 '")
        find(12)
        browser.until(f"{shown} === '12 at 12'")
        take(14)
        find(13)
        browser.until(f"{shown} === '13 at 13'")
        for second in range(100, 120):
            take(second)
        browser.until(f"{shown} === '119 at 13'")  # what it was made of is gone
        browser.until(says(".panel .bar .hint", "found is 2 min older than the picture"))

    def test_a_scan_and_a_map_are_drawn(
        self, browser: Browser, visit: Visit, senses: Senses
    ) -> None:
        visit("#/graph/function/laser/use/keep=1&function/map/use/keep=1")
        self.watch(browser, "laser")
        self.watch(browser, "map")
        scan = {"angle_min": 0.0, "angle_max": 1.5, "angle_increment": 0.5}
        senses.of["laser"].emit({**scan, "ranges": [1.0, 2.0, 4.0, float("inf")]})
        label = "document.querySelector('.scan svg')?.ariaLabel ?? ''"
        browser.until(f"({label}) === 'Scan: 3 of 4 beams see something, at most 4 m away'")
        assert (
            browser.js("document.querySelector('.scan .dots').getAttribute('d').match(/M/g).length")
            == 3
        )
        info = {"width": 2, "height": 1, "resolution": 0.05}
        senses.of["map"].emit({"info": info, "data": [100, -1]})
        browser.until(says(".grid figcaption", "0.05 m"))
        pixel = (
            "document.querySelector('.grid canvas').getContext('2d').getImageData(0, 0, 2, 1).data"
        )
        browser.until(f"[...{pixel}].join() === '24,32,44,255,178,190,205,255'")


def test_who_an_application_is_stands_with_name_and_address(
    browser: Browser, visit: Visit, talk: Connect
) -> None:
    connection = talk().open("camera")
    visit("#/graph/function/camera")
    browser.until(says(".panel .parts .hint", "local, 127.0.0.1:"))
    browser.until(says(f'[data-card="connection/{connection}"]', f"local ({connection})"))


def test_who_may_not_kill_sees_what_gives_the_right(
    browser: Browser, serve: Serve, tmp_path: Path
) -> None:
    access = tmp_path / "access.yaml"
    access.write_text(
        f"""
version: 1
roles: {{guest: {{see: all, request: ["*"]}}}}
tokens: [{{name: person, role: guest, sha256: {hash_token("right")}}}]
""",
        encoding="utf-8",
    )
    port = serve(access=access).ports[0]
    with Talk(f"ws://127.0.0.1:{port}/?token=right") as client:
        client.open("camera")
        browser.go(f"http://127.0.0.1:{port}/#/graph/function/camera")
        browser.click(".lock input")
        browser.write("right")
        browser.press("Enter")
        browser.until(says(".panel", "uoarm token NAME --role ROLE"))
        assert not browser.js("document.querySelector('.panel .button.bad')")
    browser.complaints.clear()  # the refusals before the token: a browser reports them all


def test_who_may_only_look_sees_what_gives_the_rights(
    browser: Browser, serve: Serve, tmp_path: Path
) -> None:
    access = access_file(tmp_path, GUEST, {"right": "right"})
    port = serve(access=access).ports[0]
    browser.go(f"http://127.0.0.1:{port}/#/graph/function/camera")
    browser.click(".lock input")
    browser.write("right")
    browser.press("Enter")
    needs = "To {}, a role needs the {}; uoarm token NAME --role ROLE"
    browser.until(says(".panel", needs.format("record it", "rights request and record")))
    for function, to, right in (
        ("camera", "watch it", "request"),
        ("drive", "call it", "call"),
        ("echo", "send to it", "send"),
    ):
        browser.js(f"location.hash = '#/graph/function/{function}/use'")
        browser.until(says(".panel", needs.format(to, f"right {right}")))
        assert not browser.js("document.querySelector('.panel .button')")
    browser.complaints.clear()  # the refusals before the token: a browser reports them all


@pytest.mark.needs("record")
class TestRecordings:
    """A button that records."""

    def test_a_function_is_recorded_by_a_button(
        self, browser: Browser, serve: Serve, tmp_path: Path
    ) -> None:
        server = serve(recordings=tmp_path)
        browser.go(f"http://127.0.0.1:{server.ports[0]}/#/graph/function/camera")
        browser.click(".panel .button", "Record")
        browser.until(says(".panel", "Stop recording"))
        front.take((1, 2, 3))
        browser.until(says(".panel", ".mcap"))
        browser.click(".panel .button", "Stop recording")
        browser.until(says(".panel", "ended"))
        assert list(tmp_path.glob("*.mcap"))


@pytest.mark.needs("record")
class TestPlayer:
    """The scrubber of a recording that a bridge plays."""

    TAPE = """
version: 1
bridges: {tape: {plugin: recording, options: {file: FILE, paused: true}}}
functions:
  then: {components: [{name: of_then, bridge: tape, output: {endpoint: [/counter]}}]}
"""
    AT = "Number(document.querySelector('.player input')?.value ?? NaN)"
    PRESSABLE = "[...document.querySelectorAll('.player input, .player button, .player select')]"

    @pytest.fixture
    def robot(self, tmp_path: Path) -> Iterator[RobotManager]:
        """Play nine messages, a second apart each."""
        from mcap.writer import Writer

        path = tmp_path / "then.mcap"
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            schema = writer.register_schema("Count", "jsonschema", json.dumps(COUNT).encode())
            channel = writer.register_channel("/counter", "json", schema)
            for n in range(9):
                writer.add_message(channel, (1000 + n) * 10**9, b'{"n": %d}' % n, 0)
            writer.finish()  # type: ignore[no-untyped-call]  # of mcap
        with RobotManager(loads(self.TAPE.replace("FILE", json.dumps(str(path))))) as robot:
            yield robot

    def test_it_steps_seeks_changes_speed_and_plays(
        self, browser: Browser, visit: Visit, robot: RobotManager
    ) -> None:
        with robot.request("then", queue=QueuePolicy(length=100, policy="block")) as connection:
            visit("#/graph/function/then")
            browser.until(says(".player", "tape plays then.mcap"))
            browser.until(f"{self.AT} === 0")
            for n in (0, 1):
                browser.click(".player button", "Step")
                assert connection.get(patience()) == {"n": n}
            browser.until(f"{self.AT} === 1")
            browser.click(".player input")
            browser.until(f"Math.abs({self.AT} - 4) < 0.5")
            wait(lambda: robot.playback("tape").position == pytest.approx(4, abs=0.5))
            browser.click(".player button", "Step")
            assert connection.get(patience())["n"] in {4, 5}  # its middle is 4, give or take
            browser.js("document.querySelector('.player input').focus()")
            browser.press("Home")
            browser.until(f"{self.AT} === 0")
            browser.js(
                "(s => { s.value = 'fast'; s.dispatchEvent(new Event('change', { bubbles: true })) "
                "})(document.querySelector('.player select'))"
            )
            wait(lambda: robot.playback("tape").rate is None)
            assert robot.playback("tape").is_paused
            browser.click(".player button", "Play")
            played = [connection.get(patience())["n"]]
            while played[-1] != 8:
                played.append(connection.get(patience())["n"])
            assert played[-9:] == [*range(9)]

    def test_what_is_pressed_stays_where_it_is_while_messages_come_and_are_lost(
        self, browser: Browser, visit: Visit, robot: RobotManager
    ) -> None:
        with robot.request("then", queue=QueuePolicy(length=1)):
            visit("#/graph/function/then")
            browser.until(says(".panel-body", "Kill"))
            browser.until(says(".player", "0 ms of 8 s"))
            before = browser.js(BUTTONS)
            for n in (0, 1):
                browser.click(".player button", "Step")
                browser.until(says(".panel .facts", f"received\n{n + 1}"))
            browser.until(says(".player", "1 s of 8 s"))
            browser.until(says(".panel .facts", "dropped\n1"))
            assert browser.js(BUTTONS) == before

    def test_a_kill_stays_where_it_is_as_the_application_raises(
        self, browser: Browser, visit: Visit, robot: RobotManager
    ) -> None:
        with robot.request("then", on_message=[].__getitem__):
            visit("#/graph/connection/c1")
            browser.until(says(".panel-body", "Kill"))
            before = browser.js(BUTTONS)
            robot.playback("tape", step=True)
            browser.until(says(".panel", "raised TypeError"))
            assert browser.js(BUTTONS) == before

    def test_it_stays_as_last_known_while_nothing_is_answered(
        self, browser: Browser, server: Server, between: Between
    ) -> None:
        proxy = between(server)
        browser.go(f"http://127.0.0.1:{proxy.port}/#/graph/function/then")
        browser.until(says(".player", "0 ms of 8 s"))
        assert "last known" not in browser.js("document.body.innerText")
        proxy.cut(admit=False)
        browser.until(says(".panel", "as last known"))
        assert "0 ms of 8 s" in browser.js("document.querySelector('.player').innerText")
        proxy.admit()
        browser.until(f"!{says('.panel', 'as last known')}")
        browser.go("about:blank")
        browser.complaints.clear()  # the refusals meanwhile: a browser reports them all

    def test_it_is_seen_everywhere_that_this_was_recorded(
        self, browser: Browser, visit: Visit
    ) -> None:
        visit("#/graph/function/then/use")
        browser.click(".panel .button.main", "Watch")
        browser.until(says(".panel .notice.warn", "comes from a recording"))
        browser.until(says(".panel .facts", "of_then (recorded)"))
        browser.until(says('[data-card="function/then"] .row', "recorded"))
        browser.click(".tabs a", "Overview")
        browser.until(says(".panel .parts:last-of-type .part-head", "recorded"))
        browser.click(".panel [aria-label='Close (Escape)']")
        browser.click("nav a", "List")
        browser.until(says('[data-item="then"]', "of_then (recorded)"))

    def test_it_cannot_be_moved_without_the_right(
        self, browser: Browser, serve: Serve, tmp_path: Path
    ) -> None:
        access = access_file(tmp_path, GUEST, {"right": "right"})
        browser.go(f"http://127.0.0.1:{serve(access=access).ports[0]}/#/graph/function/then")
        browser.click(".lock input")
        browser.write("right")
        browser.press("Enter")
        browser.until(says(".player", "a role needs the right record"))
        assert browser.js(f"{self.PRESSABLE}.every((control) => control.disabled)")
        browser.complaints.clear()  # the refusals before the token: a browser reports them all


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
        # Each as tall as what is in it, and below the button that stops everything.
        browser.until(
            "[...document.querySelectorAll('.panel-body')]"
            ".every((body) => body.scrollHeight <= body.clientHeight + 1)"
        )
        assert browser.js(
            "(({ x, y, width, height }) => document.elementFromPoint(x + width / 2, y + height / 2)"
            ".closest('.stop-all') !== null)"
            "(document.querySelector('.stop-all').getBoundingClientRect())"
        )
        browser.click('[data-panel="function/echo"] [aria-label="Close (Escape)"]')
        browser.until(f"{PANELS} === 'function/camera'")


MOVING = """data:text/html,<script>
let measured = 0;
const pressed = [];
for (const [at, name] of ["meant", "other"].entries()) {
  const button = document.createElement("button");
  button.textContent = name;
  button.style = `position: absolute; width: 90px; left: ${100 * at}px`;
  button.onclick = () => pressed.push(name);
  document.documentElement.append(button);
}
const [meant, other] = document.querySelectorAll("button");
meant.getBoundingClientRect = () => {
  const box = Element.prototype.getBoundingClientRect.call(meant);
  measured += 1;
  const swap = () => [meant.style.left, other.style.left] = [other.style.left, meant.style.left];
  if (measured === 1 || measured === 3) queueMicrotask(swap);
  return box;
};
</script>"""


def test_a_click_of_these_tests_presses_what_is_meant_though_it_moves(browser: Browser) -> None:
    browser.go(MOVING)
    browser.click("button", "meant")
    assert browser.js("pressed") == ["meant"]
