"""Functions that say what they need: what bridges see is a candidate where it is proven to fit."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from attrs import evolve

from uoarm import BridgeTimeoutError, Connection, ResolutionError, RobotManager
from uoarm._control import candidates
from uoarm._dataplane import Clock
from uoarm._resolve import add_candidates
from uoarm.bridge import Description, Discovered
from uoarm.config import loads, suggest
from uoarm.model import Endpoint, Robot, Schema
from uoarm.testing import MemoryBridge, patience, wait

SMALL: Schema = {"type": "integer", "minimum": 0, "maximum": 9}
NUMBER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
HEAD = (
    "version: 1\nbridges: {lab: {plugin: memory}, far: {plugin: memory, host: true}}\nfunctions:\n"
)
FIRST_AND_GUEST = ["camera@lab/first", "camera@lab/guest7"]
CAMERA = HEAD + "  camera: {needs: {structure: {type: integer}}}\n"


class Showing(MemoryBridge):
    """A bridge that does not show everything."""

    def __init__(self, name: str) -> None:
        super().__init__(name, {})
        self.hidden: set[str] = set()
        self.shown_at = 0
        self.may_answer = threading.Event()
        self.may_answer.set()
        self.rounds = 0
        self.described: list[str] = []
        self.on_describe: Callable[[str], object] = self.described.append

    def _describe(self, endpoint: Endpoint) -> Description:
        self.on_describe(endpoint.component)
        return super()._describe(endpoint)

    def _discover(self) -> tuple[Discovered, ...]:
        self.may_answer.wait()
        self.rounds += 1
        if self.rounds == self.shown_at:
            self.hidden.clear()
        return tuple(
            discovered for discovered in super()._discover() if discovered.name not in self.hidden
        )


class Lab:
    """Two bridges of a robot, of which one counts as hosted."""

    def __init__(self) -> None:
        self.lab, self.far = Showing("lab"), Showing("far")

    def manager(self, text: str | Robot, clock: Clock = time.monotonic) -> RobotManager:
        """Return a manager over them."""
        robot = loads(text) if isinstance(text, str) else text
        return RobotManager(robot, bridges={"lab": self.lab, "far": self.far}, clock=clock)


@pytest.fixture
def lab(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    monkeypatch.setattr("uoarm._resolve._discovery._EVERY_SECONDS", 0.05)
    monkeypatch.setattr("uoarm._resolve._discovery._SETTLE_SECONDS", 0.0)
    made = Lab()
    yield made
    made.far.may_answer.set()


def candidates_of(manager: RobotManager, function: str) -> list[str]:
    return [component.name for component in manager.config.functions[function].components]


def test_what_is_seen_and_fits_provides_a_function_that_names_no_provider(lab: Lab) -> None:
    head = lab.lab.emitter("head", NUMBER)
    lab.lab.emitter("sign", TEXT)
    with lab.manager(CAMERA) as manager:
        camera = manager.request("camera")
        head.emit(7)
        assert camera.get(timeout=patience()) == 7
        text = str(camera.plan)
    assert "camera@lab/head (lab, discovered: exact structure, this machine, native)" in text
    assert "camera: camera@lab/sign (discovered)" in text


ORDERS = {
    "": ["lab/a", "lab/b", "far/exact", "lab/small"],
    ", prefer: far, name: [b, '*']": ["far/exact", "lab/b", "lab/a", "lab/small"],
    ", exclude: lab": ["far/exact"],
    ", port: [small, exact]": ["far/exact", "lab/small"],
}


@pytest.mark.parametrize(("more", "order"), ORDERS.items())
def test_candidates_stand_in_the_order_of_the_rules(lab: Lab, more: str, order: list[str]) -> None:
    lab.far.emitter("exact", NUMBER)
    lab.lab.emitter("small", SMALL)
    lab.lab.emitter("b", NUMBER)
    lab.lab.emitter("a", NUMBER)
    with lab.manager(CAMERA.replace("integer}", f"integer}}{more}")) as manager:
        manager.resolve("camera")
        assert candidates_of(manager, "camera") == [f"camera@{name}" for name in order]


def test_where_nothing_of_the_kind_is_seen_that_is_said(lab: Lab) -> None:
    with lab.manager(CAMERA) as manager, pytest.raises(ResolutionError) as refused:
        manager.resolve("camera")
    assert "no bridge sees a component of that kind, role and name" in str(refused.value)


def test_what_is_seen_is_reported_as_if_it_were_no_candidate(lab: Lab) -> None:
    lab.lab.emitter("head", NUMBER)
    with lab.manager(CAMERA) as manager:
        manager.resolve("camera")
        seen, _ = manager.discover()
        assert seen.components[0].ports[0].used_by == ()
        assert "  head:  # head of lab" in suggest(loads(CAMERA), manager.discover())


def test_who_is_named_comes_first_and_is_never_replaced(lab: Lab) -> None:
    lab.lab.emitter("head", NUMBER)
    lab.lab.emitter("hand", SMALL)
    named = "components: [{name: head, bridge: lab, priority: -5, output: {endpoint: [hand]}}]"
    with lab.manager(CAMERA.replace("{needs", f"{{{named}, needs")) as manager:
        assert manager.resolve("camera").provider.component.name == "head"
        assert candidates_of(manager, "camera") == ["head", "camera@lab/head"]


def test_several_that_fit_equally_well_are_refused_where_that_is_asked(lab: Lab) -> None:
    lab.lab.emitter("left", NUMBER)
    lab.lab.emitter("right", NUMBER)
    text = CAMERA.replace("integer}", "integer}, ambiguous: refuse")
    with lab.manager(text) as manager, pytest.raises(ResolutionError) as refused:
        manager.resolve("camera")
    assert "2 fit equally well, which is refused: camera@lab/left, camera@lab/right" in str(
        refused.value
    )


@pytest.mark.parametrize("like", ["head/Row", "model"])
def test_a_function_may_be_like_a_type_or_another_function(lab: Lab, like: str) -> None:
    lab.lab.emitter("head", NUMBER)
    lab.lab.emitter("sign", TEXT)
    text = HEAD + (
        "  model: {components: [{name: model, bridge: lab, output: {endpoint: [head]}}]}\n"
        f"  camera: {{needs: {{like: {like}}}}}\n"
    )
    with lab.manager(text) as manager:
        plan = manager.resolve("camera")
    assert plan.provider.component.name == "camera@lab/head"


def test_what_appears_is_a_candidate_and_what_dies_is_replaced_by_one(lab: Lab) -> None:
    first = lab.lab.emitter("first", NUMBER)
    with lab.manager(CAMERA) as manager:
        camera = manager.request("camera")
        second = lab.far.emitter("second", NUMBER)
        wait(lambda: len(candidates_of(manager, "camera")) == 2)
        assert manager.revision == 0
        first.emit(1)
        lab.lab.die("first", "it was unplugged")
        wait(lambda: len(camera.gaps) == 1)
        second.emit(2)
        assert [camera.get(timeout=patience()) for _ in range(2)] == [1, 2]


def test_of_a_thousand_that_come_and_go_between_two_rounds_only_the_last_state_counts(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.lab.emitter("first", NUMBER)
    with lab.manager(CAMERA) as manager:
        camera = manager.request("camera")
        reported: set[tuple[str, ...]] = set()
        change = manager._driver.change_candidates

        def changed(robot: Robot) -> None:
            reported.add(
                tuple(component.name for component in robot.functions["camera"].components)
            )
            change(robot)

        monkeypatch.setattr(manager._driver, "change_candidates", changed)
        lab.lab.may_answer.clear()
        lab.lab.hidden.update(f"guest{number}" for number in range(1_000) if number != 7)
        for number in range(1_000):
            lab.lab.emitter(f"guest{number}", NUMBER)
        lab.lab.may_answer.set()
        wait(lambda: tuple(FIRST_AND_GUEST) in reported)
        assert reported <= {tuple(FIRST_AND_GUEST[:1]), tuple(FIRST_AND_GUEST)}
        assert not camera.gaps


def test_who_asks_first_waits_for_what_a_framework_learns_after_its_start(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm._resolve._discovery._SETTLE_SECONDS", patience())
    lab.lab.emitter("head", NUMBER)
    lab.lab.hidden.add("head")
    lab.lab.shown_at = 3
    with lab.manager(CAMERA) as manager:
        assert manager.resolve("camera").provider.component.name == "camera@lab/head"


def test_a_slow_bridge_delays_no_candidate_but_who_asks_waits_for_its_first_answer(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(candidates, "_ASK_SECONDS", 10 * patience())
    monkeypatch.setattr(candidates, "_GRACE_SECONDS", 0.0)
    lab.lab.emitter("small", SMALL)
    lab.far.emitter("exact", NUMBER)
    lab.far.may_answer.clear()
    with lab.manager(CAMERA) as manager:
        for _ in range(2):
            with pytest.raises(BridgeTimeoutError, match=r"have not yet listed .* 0\.01 s: "):
                manager.resolve("camera", timeout=0.01)
            wait(lambda: candidates_of(manager, "camera") == ["camera@lab/small"])
        lab.far.may_answer.set()
        plan = manager.resolve("camera", timeout=patience())
        assert plan.provider.component.name == "camera@far/exact"


def test_a_function_that_no_candidate_can_feed_waits_for_no_bridge(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(candidates, "_ASK_SECONDS", 10 * patience())
    monkeypatch.setattr(candidates, "_GRACE_SECONDS", 10 * patience())
    lab.lab.emitter("head", NUMBER)
    lab.lab.loop("finder", NUMBER)
    lab.far.may_answer.clear()
    ends = "input: {from: camera, endpoint: [finder]}, output: {endpoint: [finder]}"
    written = (
        "  eye: {components: [{name: eye, bridge: lab, output: {endpoint: [head]}}]}\n"
        f"  face: {{components: [{{name: finder, bridge: lab, {ends}}}]}}\n"
    )
    with lab.manager(CAMERA + written) as manager:
        plan = manager.resolve("eye", timeout=patience())
        with manager.request("eye", timeout=patience()) as eye:
            assert eye.plan == plan
        for name in ("camera", "face"):
            with pytest.raises(BridgeTimeoutError, match="have not yet listed"):
                manager.resolve(name, timeout=0.01)
        lab.far.may_answer.set()
        plan = manager.resolve("face", timeout=patience())
        assert plan.provider.component.name == "finder"


def test_what_is_in_use_stays_a_candidate_while_no_bridge_shows_it(lab: Lab) -> None:
    head = lab.lab.emitter("head", NUMBER)
    with lab.manager(CAMERA) as manager:
        camera = manager.request("camera")
        lab.lab.hidden.add("head")
        lab.far.emitter("other", NUMBER)
        wait(lambda: "camera@far/other" in candidates_of(manager, "camera"))
        assert "camera@lab/head" in candidates_of(manager, "camera")
        head.emit(1)
        assert camera.get(timeout=patience()) == 1
        assert camera.gaps == ()
        camera.kill()
        wait(lambda: candidates_of(manager, "camera") == ["camera@far/other"])


def test_what_is_requested_while_a_round_is_proving_stays_as_it_runs(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.lab.emitter("head", NUMBER)
    lab.lab.emitter("exact", NUMBER)
    lab.lab.hidden.add("exact")
    lab.far.loop("finder", NUMBER)
    text = HEAD + "".join(
        f"  {name}: {{needs: {{name: {seen}}}}}\n"
        for name, seen in (("eye", "exact"), ("camera", "head"), ("face", "finder"))
    )
    faces: list[Connection] = []

    def request_when_proven(*given: Any, **more: Any) -> Robot:
        found = add_candidates(*given, **more)
        fed_by = {str(end.source) for component in found.components() for end in component.inputs}
        if fed_by == {"eye"} and not faces:
            faces.append(manager.request("face"))
        return found

    monkeypatch.setattr(candidates, "add_candidates", request_when_proven)
    with lab.manager(text) as manager:
        assert manager.resolve("face").steps[0].component.function == "camera"
        lab.lab.hidden.clear()
        wait(lambda: candidates_of(manager, "eye"))
        again = manager.request("face")
        assert again.plan.steps == faces[0].plan.steps
        for face in (*faces, again):
            face.kill()
        wait(lambda: manager.resolve("face").steps[0].component.function == "eye")


def test_a_chain_is_fed_by_what_fits(lab: Lab) -> None:
    head = lab.lab.emitter("head", SMALL)
    lab.far.loop("finder", NUMBER)
    text = HEAD + "  face: {needs: {name: finder}}\n  camera: {needs: {name: head}}\n"
    with lab.manager(text) as manager:
        face = manager.request("face")
        head.emit(3)
        assert face.get(timeout=patience()) == 3
        assert [step.component.function for step in face.plan.steps] == ["camera", "face"]
    assert "default from camera, contained" in str(face.plan)


def test_what_has_no_output_is_not_asked_what_it_could_feed_others_with(lab: Lab) -> None:
    """A device that is not there would be waited for, by clients that ask for anything else."""
    lab.lab.emitter("head", NUMBER)
    lamp = "  lamp: {components: [{name: lamp, bridge: lab, input: {endpoint: [lamp]}}]}\n"
    with lab.manager(CAMERA + lamp) as manager:
        manager.resolve("camera")
        assert "lamp" not in lab.lab.described


def test_what_takes_long_to_give_its_structure_takes_proofs_no_time(lab: Lab) -> None:
    """A vehicle that could be fed was passed over where a device far from it was not there."""
    lab.lab.emitter("head", SMALL)
    lab.far.loop("finder", NUMBER)
    now = [0.0]

    def describe(component: str) -> None:
        if component == "eye":  # for its structure; others are described as they are discovered
            now[0] += 20.0

    lab.lab.on_describe = describe
    camera = "  camera: {components: [{name: eye, bridge: lab, output: {endpoint: [head]}}]}\n"
    with lab.manager(f"{HEAD}  face: {{needs: {{name: finder}}}}\n{camera}", lambda: now[0]) as one:
        plan = one.resolve("face")
    assert [step.component.function for step in plan.steps] == ["camera", "face"]


def test_what_is_not_there_does_not_hold_up_every_round(lab: Lab) -> None:
    """Each time its bridge would wait for it, and every round would take that long."""
    lab.lab.emitter("head", SMALL)
    now = [0.0]

    def describe(component: str) -> None:
        lab.lab.described.append(component)
        if component == "eye":
            now[0] += 0.01

    lab.lab.on_describe = describe
    eye = "  eye: {components: [{name: eye, bridge: lab, output: {endpoint: [eye]}}]}\n"
    with lab.manager(f"{CAMERA}{eye}", lambda: now[0]) as manager:
        manager.resolve("camera")
        before = lab.lab.rounds
        wait(lambda: lab.lab.rounds > before + 3)
        assert lab.lab.described.count("eye") == 1
        now[0] += 1.0
        wait(lambda: lab.lab.described.count("eye") == 2)


@pytest.mark.parametrize("unfed", ["", ", unfed: default"])
def test_a_component_whose_input_nothing_feeds_is_passed_over_unless_it_may_be(
    lab: Lab, unfed: str
) -> None:
    lab.lab.emitter("sign", TEXT)
    lab.far.loop("finder", NUMBER)
    text = f"  face: {{needs: {{name: finder{unfed}}}}}\n  sign: {{needs: {{name: sign}}}}\n"
    with lab.manager(HEAD + text) as manager:
        if unfed:
            assert manager.resolve("face").provider.component.inputs == ()
            return
        with pytest.raises(ResolutionError, match="no function feeds its input default"):
            manager.resolve("face")


def test_an_input_that_is_the_applications_is_fed_by_no_function(lab: Lab) -> None:
    """Though one has its very name and structure, as another vehicle's goals have."""
    default = lab.lab.emitter("default", NUMBER)
    lab.far.loop("vehicle", NUMBER)
    text = "  default: {needs: {name: default}}\n  drive: {needs: {name: vehicle@}}\n"
    text = HEAD + text.replace("vehicle@", "vehicle, from_application: 'def*'")
    with lab.manager(text) as manager:
        drive = manager.request("drive")
        assert [step.component.function for step in drive.plan.steps] == ["drive"]
        assert "default from the application" in str(drive.plan)
        default.emit(1)
        drive.send(2)
        assert drive.get(timeout=patience()) == 2


def test_a_service_is_found_by_what_it_takes_and_answers(lab: Lab) -> None:
    lab.lab.service("double", NUMBER, NUMBER, lambda number: 2 * number)
    text = HEAD + "  twice: {needs: {role: service, request: {type: integer}}}\n"
    with lab.manager(text) as manager:
        assert manager.call("twice", 4) == 8


def test_a_change_of_configuration_keeps_what_was_discovered(lab: Lab) -> None:
    head = lab.lab.emitter("head", NUMBER)
    with lab.manager(CAMERA) as manager:
        camera = manager.request("camera")
        change = manager.apply(loads(CAMERA + "  sign: {needs: {name: sign}}\n"))
        assert change.connections == ()
        head.emit(1)
        assert camera.get(timeout=patience()) == 1
        assert camera.gaps == ()
        again = manager.apply(evolve(manager.config))  # candidates in it count for nothing
        assert manager.history()[-1].robot == loads(CAMERA + "  sign: {needs: {name: sign}}\n")
        assert again.differences == ()
