"""The dashboard in a real Chromium: what a person does with pointer and keyboard, and sees."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.host import joined
from tests.server.browser import CONTRAST, Browser, says, text
from tests.server.conftest import Connect, Serve, Visit
from tests.server.serving import access_file
from tests.server.shown import END, crowd, front, manage, shown_robot
from tests.server.talk import eventually

from uoarm import RobotManager
from uoarm.bridge import BridgeType, Registry
from uoarm.config import load, loads
from uoarm.server import ServerOptions, hash_token, serve_in_thread
from uoarm.server.access._approvals import ApprovalFoundation, ApprovalRequest
from uoarm.testing import MemoryBridge, free_port, patience, wait

MOVES = """
version: 1
bridges: {memory: {plugin: python}}
functions:
  move: {components: [{name: base, bridge: memory, input: {endpoint: [base], stop: {message: 0}}}]}
"""
TWICE = """
version: 1
bridges: {memory: {plugin: python}}
functions:
  range:
    components:
      - {name: laser, bridge: memory, priority: 1, output: {endpoint: [laser]}}
      - {name: sonar, bridge: memory, output: {endpoint: [sonar]}}
"""
GUEST = """
version: 1
roles: {{guest: {{see: all}}}}
tokens: [{{name: person, role: guest, sha256: {right}}}]
"""
APPROVER = """
version: 1
roles: {{nurse: {{see: all, approve: ["*"]}}}}
tokens: [{{name: tablet, principal: ada, role: nurse, sha256: {right}}}]
"""
pytestmark = pytest.mark.needs("chromium")


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    with shown_robot() as robot:
        yield robot


def test_the_graph_shows_functions_components_and_what_flows(
    browser: Browser, visit: Visit, talk: Connect
) -> None:
    client = talk()
    client.open("faces")
    visit()
    browser.until("document.querySelectorAll('.card.function').length === 5")
    browser.until("document.querySelectorAll('.row.open').length === 2")
    browser.until(says('[data-card="connection/c1"]', "faces"))
    assert "loose" in browser.js(text('[data-card="function/faces"] .row.open'))

    def flows() -> bool:
        front.take((9, 9, 9))
        return bool(browser.js("document.querySelectorAll('.edge.flows.moving').length === 2"))

    wait(flows, "nothing flows")
    browser.until(says('[data-card="function/camera"] .row.open', "/s"))
    # Any would paint the whole graph 60 times a second, for as long as messages come.
    assert browser.js("document.getAnimations().length") == 0


def test_frameworks_can_be_shown(browser: Browser, visit: Visit) -> None:
    visit()
    browser.click(".graph-tools .tool", "Frameworks")
    browser.until(says('[data-card="bridge/other"]', "0 of 1 running"))
    assert browser.js("document.querySelectorAll('.edge.runs').length") == 0  # they would cross
    browser.click('[data-card="bridge/other"]')
    dim = "[...document.querySelectorAll('.card.dim')].map((card) => card.dataset.card).sort()"
    browser.until("document.querySelector('.card.dim')")
    assert browser.js(dim) == [
        "bridge/python",
        "function/camera",
        "function/drive",
        "function/echo",
        "function/hopeless",
    ]


class TestOtherMachines:
    """One whose host comes and goes."""

    @pytest.fixture
    def place(self) -> str:
        return f"127.0.0.1:{free_port()}"

    @pytest.fixture
    def robot(self, tmp_path: Path, place: str) -> Iterator[RobotManager]:
        path = joined.robot(tmp_path, int(place.rpartition(":")[2]))
        with RobotManager.from_file(path) as manager:
            yield manager

    def test_they_are_shown(
        self, browser: Browser, visit: Visit, tmp_path: Path, place: str
    ) -> None:
        visit()
        browser.click(".graph-tools .tool", "Frameworks")
        browser.until(says('[data-card="machine/arm"].is-lost', "not here"))
        browser.until("document.querySelectorAll('.edge.runs').length > 0")
        browser.click('[data-card="machine/arm"]')
        browser.until(says(".panel .notice", "waiting for its bridge far"))
        with joined.Joined(tmp_path, f"tls/{place}"):
            browser.until(says('[data-card="machine/arm"].is-ok', "here"))
            browser.until(says(".panel .facts", "give or take"))
            browser.until(says(".panel .parts", "far"))
        browser.until(says('[data-card="machine/arm"].is-lost', "not here"))


def test_a_picture_is_watched(browser: Browser, visit: Visit, robot: RobotManager) -> None:
    visit()
    browser.click('[data-card="function/camera"]')
    browser.click(".tabs a", "Watch")
    browser.click(".button.main", "Watch")
    browser.until(says(".panel", "No message yet"))
    front.take((250, 100, 3))
    browser.until("document.querySelector('.picture canvas')")
    pixel = "[...document.querySelector('canvas').getContext('2d').getImageData(3, 2, 1, 1).data]"
    browser.until(f"{pixel}.join() === '250,100,3,255'")
    assert browser.js(says(".message", '"encoding": "rgb8"'))
    browser.click(".button", "Stop")
    eventually(lambda: robot.status().connections == (), "the connection is given back")


def test_a_service_is_called_with_a_form_of_its_schema(browser: Browser, visit: Visit) -> None:
    visit("#/graph/function/drive/use")
    browser.click('[id="field-x"]')
    browser.write("11")
    browser.click(".form .button.main", "Call")
    browser.until(says(".problem", "at most 10"))
    assert browser.js("document.querySelector('#field-x').getAttribute('aria-invalid')") == "true"
    browser.until("document.activeElement.id === 'field-x'")
    browser.js("document.activeElement.select()")
    browser.write("-2.5")
    browser.until("!document.querySelector('.problem')")
    browser.click('[id="field-hurry"]')
    browser.click("fieldset .button", "Add item")
    browser.click('[id="field-stops.0.count"]')
    browser.write("7")
    browser.press("Enter")
    browser.until(says(".panel .message", "fast to -2.5 on map by 7"))


def test_a_message_is_sent_and_comes_back(browser: Browser, visit: Visit) -> None:
    visit("#/graph/function/echo/use")
    browser.click('[id="field-count"]')
    browser.write("9007199254740993")
    place = "document.querySelector('.form .button.main').getBoundingClientRect().y"
    before = browser.js(place)
    browser.click(".form .button.main", "Send")
    browser.until(says(".panel", "It was handed over."))
    browser.until(says(".panel", "9007199254740993"))
    assert browser.js(place) == before


def test_a_connection_of_another_client_is_killed(
    browser: Browser, visit: Visit, talk: Connect
) -> None:
    client = talk()
    connection = client.open("camera")
    visit("#/graph/function/camera")
    browser.click(".panel .button.bad", "Kill")
    browser.click(".panel .button.bad", "Confirm")
    assert client.next("connection")["jsonMessage"]["connection"] == connection
    browser.until(says(".panel", "None at this moment."))
    browser.click(".top nav a", "Timeline")
    browser.until(says(".timeline", "by this page"))


def test_a_death_is_shown_with_its_cause(browser: Browser, visit: Visit, talk: Connect) -> None:
    client = talk()
    client.open("camera")
    visit()
    browser.until(says('[data-card="function/camera"] .row.open', "no message yet"))
    front.put(RuntimeError("the lens cap is on"))
    browser.until(says('[data-card="function/camera"].is-lost', "the lens cap is on"))
    browser.click(".top nav a", "Timeline")
    browser.click(".chip", "Losses only")
    browser.until(says(".event.lost", "the lens cap is on"))
    browser.click(".event .link", "front")
    browser.until(says(".panel .notice", "the lens cap is on"))


def test_what_happened_before_the_page_came_is_in_the_timeline(
    browser: Browser, visit: Visit, talk: Connect
) -> None:
    client = talk()
    client.ask("Kill", client.open("camera"))
    visit("#/timeline")
    browser.until(says(".timeline", "killed"))
    who = f"by session {client.hello['session']} (local), who used it last"
    assert browser.js(says(".timeline", who))


def test_the_resolution_is_a_tree_with_counterexamples(browser: Browser, visit: Visit) -> None:
    visit("#/graph/function/faces/explain")
    browser.until(says(".tree .chosen", "loose"))
    assert browser.js(says(".tree .chosen .chosen", "front"))
    assert browser.js(says(".tree .chosen .chosen", "proven to fit"))
    refused = browser.js(text(".tree .rejected"))
    assert "strict" in refused
    assert "counterexample" in refused
    assert "width" in refused
    assert browser.js(says(".tree .untried", "spare"))


def test_why_nothing_fits_is_a_tree_too(browser: Browser, visit: Visit) -> None:
    visit("#/graph/function/hopeless/explain")
    browser.until(says(".notice", "Every candidate was rejected"))
    assert browser.js(says(".tree .rejected", "unfit"))
    assert browser.js(says(".tree .rejected .rejected", "counterexample"))


class TestEmergencyStop:
    """Of a base that takes its stop message, or does not."""

    @pytest.fixture
    def robot(self, memory: MemoryBridge) -> Iterator[RobotManager]:
        memory.taker("base", {"type": "number"})
        given = {"memory": memory}
        with RobotManager(loads(MOVES), registry=Registry(()), bridges=given) as robot:
            yield robot

    def test_it_shows_who_has_not_stopped_until_it_has_and_is_released_when_one_is_sure(
        self, browser: Browser, visit: Visit, robot: RobotManager, memory: MemoryBridge
    ) -> None:
        robot.request("move")
        visit()
        assert not browser.js("document.querySelector('.stopped')")
        memory.cut("no radio")
        browser.click(".stop-all", "Stop all")
        browser.until(says(".stopped", "NOT STOPPED base.default (move)"))
        assert robot.is_stopped
        browser.until(says(".stopped", "no radio"))
        assert browser.js(CONTRAST) == []
        memory.mend()
        browser.until(says(".stopped", "stopped base.default (move)"))
        browser.click(".stopped .button", "Release")
        assert robot.is_stopped
        browser.click(".stopped .button", "Confirm")
        browser.until("!document.querySelector('.stopped')")
        assert not robot.is_stopped

    def test_without_an_answer_it_says_so_and_connects_again(
        self, browser: Browser, visit: Visit
    ) -> None:
        visit()
        # As where the network goes without a word: for a quarter of an hour nothing breaks.
        browser.js("void (window.given = WebSocket.prototype.send)")
        browser.js("void (WebSocket.prototype.send = () => {})")
        browser.click(".stop-all", "Stop all")
        browser.until(says(".stopped", "NOT STOPPED"))
        assert "has not answered" in browser.js(text(".stopped"))
        browser.until("document.querySelector('.link-state.closed')")
        browser.js("void (WebSocket.prototype.send = window.given)")
        browser.until("document.querySelector('.link-state.open')")

    def test_that_it_is_not_stopped_is_not_said_when_it_is(
        self, browser: Browser, visit: Visit, robot: RobotManager
    ) -> None:
        visit()
        browser.js("void (window.given = WebSocket.prototype.send)")
        lost = "if (!JSON.parse(text).op.startsWith('Stop')) window.given.call(this, text)"
        browser.js(f"void (WebSocket.prototype.send = function (text) {{ {lost} }})")
        browser.click(".stop-all", "Stop all")
        browser.until(says(".stopped", "NOT STOPPED"))
        robot.stop_all()
        browser.until(says(".stopped", "Nothing open moves."))
        assert "NOT STOPPED" not in browser.js(text(".stopped"))
        browser.click(".stopped .button", "Release")
        browser.click(".stopped .button", "Confirm")
        browser.until(says(".stopped", "Not released"))
        robot.release()
        browser.until("!document.querySelector('.stopped')")

    def test_a_client_without_the_right_gets_an_error_and_nothing_is_stopped(
        self, browser: Browser, serve: Serve, robot: RobotManager, tmp_path: Path
    ) -> None:
        access = access_file(tmp_path, GUEST, {"right": "right"})
        server = serve(access=access)
        browser.show(375, 720, phone=True)
        browser.go(f"http://127.0.0.1:{server.ports[0]}/")
        browser.until("document.querySelector('.lock input')")
        browser.click(".lock input")
        browser.write("right")
        browser.press("Enter")
        browser.until("document.querySelector('.link-state.open')")
        browser.click(".stop-all", "Stop all")
        browser.until(says(".stopped", "may not stop"))
        assert "NOT STOPPED" in browser.js(text(".stopped"))
        assert not robot.is_stopped
        browser.complaints.clear()  # of the page that had no token yet
        assert browser.js("document.documentElement.scrollWidth") == 375


class TestTakeover:
    """Of a function with another candidate."""

    @pytest.fixture
    def memory(self) -> MemoryBridge:
        memory = MemoryBridge()
        memory.emitter("laser", {"type": "number"})
        memory.emitter("sonar", {"type": "number"})
        return memory

    @pytest.fixture
    def robot(self, memory: MemoryBridge) -> Iterator[RobotManager]:
        given = {"memory": memory}
        with RobotManager(loads(TWICE), registry=Registry(()), bridges=given) as robot:
            yield robot

    def test_what_is_watched_says_through_what_it_goes_now(
        self, browser: Browser, visit: Visit, memory: MemoryBridge
    ) -> None:
        visit("#/graph/function/range/use")
        browser.click(".button.main", "Watch")
        browser.until(says(".panel .facts", "laser"))
        memory.die("laser")
        browser.until(says(".panel .facts", "sonar"))
        assert not browser.js(says(".panel .facts", "laser"))


def test_everything_works_by_keyboard(browser: Browser, visit: Visit) -> None:
    visit()
    browser.until("document.querySelector('.card')")
    browser.press("/")
    browser.until("document.activeElement.type === 'search'")
    browser.write("camera")
    browser.until("document.querySelectorAll('.card.function').length === 1")
    for _ in range(9):
        browser.press("Tab")
        if browser.js("document.activeElement.dataset.title ?? ''"):
            break
    assert browser.js("document.activeElement.dataset.title") == "function/camera"
    seen = "getComputedStyle(document.activeElement.closest('.card')).outlineWidth"
    assert browser.js(seen) == "3px"
    browser.press("Enter")
    browser.until("document.activeElement.matches('.panel h2')")
    browser.press("Escape")
    browser.until("document.activeElement.dataset.title === 'function/camera'")
    browser.until("!document.querySelector('.panel')")


def test_arrows_walk_along_the_graph(browser: Browser, visit: Visit) -> None:
    visit()
    browser.until("document.querySelector('.card')")
    browser.js("document.querySelector('[data-title=\"function/camera\"]').focus()")
    browser.press("ArrowRight")
    reached = browser.js("document.activeElement.dataset.title")
    assert reached in {"function/faces", "function/hopeless"}
    rows = "document.activeElement.closest('.card').querySelectorAll('.row').length"
    assert browser.js(rows) > 0
    browser.press("f")
    browser.until(f"{rows} === 0")
    browser.press("ArrowLeft")
    assert browser.js("document.activeElement.dataset.title") == "function/camera"


LAB = """\
version: 1
bridges:
  lab: {plugin: memory}
functions:
  # the only one
  follow:
    components:
      - {name: follower, bridge: lab, input: {endpoint: [follower]}, output: {endpoint: [follower]}}
"""
KEEPERS = """
version: 1
roles: {{keeper: {{see: all, configure: all, keep: all}}}}
tokens: [{{name: person, role: keeper, sha256: {right}}}]
"""


ROOT = "document.querySelector('.editor').shadowRoot"
CONTENT = f"{ROOT}.querySelector('.cm-content')"
EDITED = (
    "(document.querySelector('.editor')?.shadowRoot?.querySelector('.cm-content')?.innerText ?? '')"
)


class TestConfiguration:
    """A user who may change it."""

    @pytest.fixture
    def lab(self) -> MemoryBridge:
        lab = MemoryBridge("lab", {})
        lab.loop("follower", {"type": "integer"})
        return lab

    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        path = tmp_path / "robot.yaml"
        path.write_text(LAB, encoding="utf-8")
        return path

    @pytest.fixture
    def robot(self, lab: MemoryBridge, file: Path) -> Iterator[RobotManager]:
        registry = Registry(())
        registry.add(BridgeType("memory", "", lambda *_: lab, contract=2))
        with RobotManager(load(file), registry=registry) as manager:
            yield manager

    @pytest.fixture
    def editing(self, browser: Browser, serve: Serve, tmp_path: Path) -> Browser:
        access = access_file(tmp_path, KEEPERS, {"right": "right"})
        server = serve(access=access)
        browser.go(f"http://127.0.0.1:{server.ports[0]}/#/configuration")
        browser.click(".lock input")
        browser.write("right")
        browser.press("Enter")
        browser.until(f"{EDITED}.includes('# the only one')")
        browser.complaints.clear()  # the refusal before the token: a browser logs it
        return browser

    def test_what_appears_is_taken_into_a_function_and_written_to_the_file(
        self, editing: Browser, lab: MemoryBridge, robot: RobotManager, file: Path
    ) -> None:
        editing.until(says(".found", "follower"))
        assert "reachable" in editing.js(text(".found-bridge"))
        camera = lab.emitter("head camera", {"type": "integer"})
        editing.until(says(".found", "head camera"))
        editing.click(".found-component .button", "head camera")
        editing.until(says(".configuration .notice", "+ component head_camera"))
        assert robot.revision == 0
        editing.click(".editor-tools input")
        editing.click(".editor-tools .button", "Apply")
        editing.until(says(".configuration .notice", "applied and kept"))
        assert file.read_text(encoding="utf-8").startswith(LAB)
        with robot.request("head_camera") as seen:
            camera.emit(3)
            assert seen.get(timeout=patience()) == 3

    def test_what_cannot_be_taken_is_said_beside_it(
        self, editing: Browser, lab: MemoryBridge
    ) -> None:
        lab.emitter("head camera", {"type": "integer"})
        editing.until(says(".found", "head camera"))
        lab.cut("no radio")
        editing.click(".found-component .button", "head camera")
        editing.until(says(".found-component .notice.bad", "Not added"))

    @pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
    def test_who_may_not_sees_first_what_gives_the_right(
        self, browser: Browser, visit: Visit, width: int, height: int
    ) -> None:
        browser.show(width, height, phone=width < 700)
        visit("#/configuration")
        browser.until(says(".configuration .notice.bad", "uoarm token NAME --role ROLE"))
        browser.until(says(".found", "follower"))
        place = "document.querySelector('.configuration .notice.bad').getBoundingClientRect()"
        assert browser.js(f"{place}.bottom") < height
        assert not browser.js("document.querySelector('.editor, .found-component .button')")
        assert browser.js("document.documentElement.scrollWidth") <= width
        assert browser.js(CONTRAST) == []

    def put(self, editing: Browser, text: str) -> None:
        """Write a text in the place of the one that is edited."""
        editing.js(f"{CONTENT}.focus()")
        editing.press("a", control=True)
        editing.press("Backspace")
        editing.write(text)

    def test_mistakes_stand_at_their_line_while_one_writes(self, editing: Browser) -> None:
        lines = f"[...{ROOT}.querySelectorAll('.cm-lineNumbers .cm-gutterElement')].length"
        assert editing.js(lines) > 6
        self.put(editing, LAB.replace("bridge: lab", "bridge: lob"))
        editing.until(f"{ROOT}.querySelector('.cm-lint-marker-error') !== null")
        marked = f"{ROOT}.querySelector('.cm-lintRange-error').closest('.cm-line').textContent"
        assert "follower" in editing.js(marked)

    def test_keys_and_names_are_completed_and_explained_by_the_schema(
        self, editing: Browser
    ) -> None:
        self.put(editing, "version: 1\nbridges:\n  lab: {plugin: memory, option")
        editing.until(f"{ROOT}.querySelector('.cm-tooltip-autocomplete li') !== null")
        offered = f"{ROOT}.querySelector('.cm-tooltip-autocomplete').innerText"
        assert "options" in editing.js(offered)
        editing.until(f"{ROOT}.querySelector('.cm-completionInfo')?.innerText.length > 10")

    def test_what_changes_stands_side_by_side_before_it_is_applied(
        self, editing: Browser, robot: RobotManager
    ) -> None:
        editing.show(1440, 900)
        self.put(editing, LAB.replace("# the only one", "# the first one"))
        editing.click(".editor-tools .button", "Preview changes")
        side = "document.querySelector('.difference')?.shadowRoot?.querySelector('{}')?.innerText"
        editing.until(f"{side.format('.cm-merge-a')}?.includes('# the only one')")
        assert "# the first one" in editing.js(side.format(".cm-merge-b"))
        assert robot.revision == 0

    def test_mistakes_are_reported_as_everywhere_and_nothing_changes(
        self, editing: Browser, robot: RobotManager
    ) -> None:
        self.put(editing, LAB.replace("functions:", "funktions:"))
        editing.click(".editor-tools .button", "Preview changes")
        editing.until(says(".configuration .notice.bad", 'unknown key "funktions"'))
        assert editing.js("document.querySelectorAll('.editor-tools .button')[1].disabled")
        editing.click(".editor-tools .button", "Reload")
        editing.until(f"{EDITED}.includes('functions:')")
        assert robot.revision == 0


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("place", ["graph/function/camera", "list", "timeline"])
def test_text_stands_out(
    browser: Browser, visit: Visit, talk: Connect, place: str, *, dark: bool
) -> None:
    client = talk()
    client.open("camera")
    front.put(RuntimeError("the lens cap is on"))
    assert client.next("connection")["jsonMessage"]["state"] == "failed"
    client.open("echo")
    browser.show(1280, 800, dark=dark)
    visit(f"#/{place}")
    browser.until("document.querySelector('.is-lost, .item .cause, .event.lost')")
    assert browser.js(CONTRAST) == []


@pytest.mark.parametrize(
    "place",
    ["list", "graph", "timeline", "list/function/camera/use", "list/function/faces/explain"],
)
def test_a_phone_needs_no_scrolling_sideways(browser: Browser, visit: Visit, place: str) -> None:
    browser.show(375, 720, phone=True)
    visit(f"#/{place}")
    browser.until("document.querySelector('.panel .notice, .tree, .item, .card, .timeline ol')")
    assert browser.js("document.documentElement.scrollWidth") == 375
    controls = "[...document.querySelectorAll('button, a, input, select')]"
    beyond = "!one.closest('.stage, .skip') && one.getBoundingClientRect().right > 376"
    assert browser.js(f"{controls}.filter(one => {beyond}).length") == 0


def test_what_was_not_asked_yet_is_no_mistake(browser: Browser, visit: Visit) -> None:
    watching = browser.command(
        "Page.addScriptToEvaluateOnNewDocument",
        source="window.seen = new Set(); addEventListener('DOMContentLoaded', () => "
        "new MutationObserver(() => document.querySelectorAll('.notice, [role=status]')"
        ".forEach((notice) => seen.add(notice.innerText)))"
        ".observe(document, { subtree: true, childList: true }))",
    )
    try:
        visit("#/configuration")
        browser.until("document.querySelector('.found-bridge')")
    finally:
        browser.command("Page.removeScriptToEvaluateOnNewDocument", **watching)
    seen = " ".join(browser.js("[...seen]"))
    assert "Asking the frameworks" in seen
    assert "not connected" not in seen


def test_a_phone_begins_with_the_list(browser: Browser, visit: Visit) -> None:
    browser.show(375, 720, phone=True)
    visit()
    browser.click(".item", "drive")
    browser.until(says(".panel", "drives to a place"))


def test_a_token_is_asked_for_where_the_server_wants_one(
    browser: Browser, serve: Serve, tmp_path: Path
) -> None:
    access = tmp_path / "access.yaml"
    access.write_text(
        f"""
version: 1
roles: {{all: {{see: all, request: ["*"]}}}}
tokens:
  - {{name: person, role: all, sha256: {hash_token("right")}}}
""",
        encoding="utf-8",
    )
    server = serve(access=access)
    browser.go(f"http://127.0.0.1:{server.ports[0]}/")
    browser.until("document.querySelector('.lock')")
    browser.click(".lock input")
    browser.write("wrong")
    browser.press("Enter")
    browser.until(says(".lock", "did not accept"))
    browser.js("document.querySelector('.lock input').select()")
    browser.write("right")
    browser.press("Enter")
    browser.until("document.querySelectorAll('.card.function').length === 5")
    browser.complaints.clear()  # the refusals: a browser logs them all


def test_what_another_asks_for_is_approved_or_refused(
    browser: Browser, serve: Serve, robot: RobotManager, tmp_path: Path
) -> None:
    access = access_file(tmp_path, APPROVER, {"right": "right"})
    server = serve(access=access)
    approvals = server.backend.approvals
    function = next(iter(robot.config.functions))
    foundation = ApprovalFoundation(robot.revision, ())
    asked = [
        approvals.ask(ApprovalRequest("agent", "call", function, "", {"angle": angle}, foundation))
        for angle in (30, 45)
    ]
    browser.go(f"http://127.0.0.1:{server.ports[0]}/")
    browser.until("document.querySelector('.lock')")
    browser.click(".lock input")
    browser.write("right")
    browser.press("Enter")
    browser.until("document.querySelectorAll('.approvals li').length === 2")
    assert browser.js(says(".approvals li", f"agent asks to call {function}"))
    assert browser.js(says(".approvals li", '"angle": 30'))
    browser.click(".approvals .bar button", "Approve")
    browser.click(".approvals .bar button", "Confirm")
    browser.until("document.querySelectorAll('.approvals li').length === 1")
    browser.click(".approvals .bar button", "Refuse")
    browser.until("!document.querySelector('.approvals')")
    found = [approvals.find(approval.id, "agent") for approval in asked]
    assert [approval.phase.value for approval in found if approval] == ["approved", "refused"]
    assert {approval.approver for approval in found if approval} == {"ada"}
    browser.complaints.clear()  # the refusals before the token: a browser reports them all


def test_the_page_comes_back_when_the_server_does(browser: Browser, robot: RobotManager) -> None:
    with serve_in_thread(robot, ServerOptions(port=0)) as first:
        port = first.ports[0]
        browser.go(f"http://127.0.0.1:{port}/#/graph/function/camera/use")
        browser.click(".button.main", "Watch")
        browser.until(says(".panel", "No message yet"))
        eventually(lambda: robot.status().connections != (), "it is open")
    browser.until("document.querySelector('.link-state.closed')")
    # A server that closes may refuse what it has not opened yet: then this is the second notice.
    browser.until(says(".panel", "broke"))
    front.put(END)  # for the camera that was watched: it waits for a picture still
    with serve_in_thread(robot, ServerOptions(port=port)):
        browser.until(says(".panel .facts", "1 time; what was missed is not known"))
        front.take((1, 2, 3))
        browser.until("document.querySelector('.picture canvas')")
        assert not browser.js("document.querySelector('.panel .notice')")
        browser.click(".button", "Stop")
        eventually(lambda: robot.status().connections == (), "the connection is given back")
        front.put(END)
    browser.until("document.querySelector('.link-state.closed')")
    with serve_in_thread(robot, ServerOptions(port=port)):
        browser.until("document.querySelector('.link-state.open')")
        browser.click(".button.main", "Watch")
        browser.until(says(".panel", "No message yet"))
        assert not browser.js(says(".panel .facts", "interrupted"))
        browser.go("about:blank")
    browser.complaints.clear()  # a browser logs every address that it could not reach


class TestManyComponents:
    """Five hundred of them."""

    @pytest.fixture
    def robot(self) -> Iterator[RobotManager]:
        with manage(crowd(100, 5)) as manager:
            yield manager

    def test_they_begin_folded_and_are_found(self, browser: Browser, visit: Visit) -> None:
        visit()
        browser.until("document.querySelectorAll('.card.function').length === 100")
        assert browser.js("document.querySelectorAll('.row').length") == 0
        assert browser.js(says(".summary", "0 of 500 components running"))
        browser.press("/")
        browser.write("part42_3")
        browser.until("document.querySelectorAll('.card.function').length === 1")
        browser.until("document.querySelectorAll('.row').length === 5")
        browser.click(".card-fold")
        browser.until("document.querySelectorAll('.row').length === 0")

    def test_all_of_them_can_be_unfolded(self, browser: Browser, visit: Visit) -> None:
        visit()
        browser.click(".graph-tools .tool", "Unfold all")
        browser.until("document.querySelectorAll('.row').length === 500")
        before = browser.js("document.querySelector('.plane').style.transform")
        browser.js("document.querySelector('.card-title').focus()")
        browser.press("+")
        assert browser.js("document.querySelector('.plane').style.transform") != before


class TestLongNames:
    """Names and texts as long as they may be."""

    FIELD, BRIDGE, PART = "field" * 60, "bridge" * 20, "part" * 32
    LONG = f"""
version: 1
bridges: {{{BRIDGE}: {{plugin: python}}, memory: {{plugin: python}}}}
functions:
  look:
    description: {"https://robot.example/" + "a" * 300} {"word " * 2000}
    components: [{{name: eye, bridge: memory, output: {{endpoint: [eye]}}}}]
  act:
    components: [{{name: {PART}, bridge: {BRIDGE}, service: {{endpoint: [act]}}}}]
"""
    WIDER = """
[...document.querySelectorAll(".panel, .panel *, .list, .summary, .configuration")]
  .filter((part) => part.clientWidth > 1 && part.scrollWidth > part.clientWidth + 1)
  .map((part) => `${part.tagName} ${part.className} ${part.scrollWidth}`)
"""

    @pytest.fixture
    def robot(self) -> Iterator[RobotManager]:
        eyes, hands = MemoryBridge(), MemoryBridge(self.BRIDGE)
        eyes.emitter("eye", {"type": "number"})
        wanted = {"type": "object", "properties": {self.FIELD: {"type": "number"}}}
        hands.service("act", wanted, wanted, lambda message: message)
        given = {"memory": eyes, self.BRIDGE: hands}
        with RobotManager(loads(self.LONG), registry=Registry(()), bridges=given) as robot:
            yield robot

    @pytest.mark.parametrize("width", [360, 1280])
    @pytest.mark.parametrize(
        "place", ["list", "configuration", "list/function/look", "list/function/act/use"]
    )
    def test_they_need_no_scrolling_sideways(
        self, browser: Browser, visit: Visit, place: str, width: int
    ) -> None:
        browser.show(width, 740)
        visit(f"#/{place}")
        if place.endswith("use"):
            browser.click(".form .button.small", self.FIELD)
            browser.until("document.querySelector('.form input')")
        browser.until("document.querySelector('.list .item, .found-bridge')")
        assert browser.js(self.WIDER) == []
        if place.endswith("look"):
            room = "document.querySelector('.panel-body').clientHeight > innerHeight / 3"
            assert browser.js(room)
