"""`uoarm up`: functions for what is there, fed by proof, without a line of configuration."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from pathlib import Path

import pytest
from click import unstyle
from click.testing import CliRunner
from tests.structures import closed

from uoarm import RobotManager
from uoarm.bridge import BridgeType, Registry
from uoarm.cli import _up, main
from uoarm.cli._serve import say
from uoarm.config import add_functions, loads
from uoarm.errors import ConnectionClosedError
from uoarm.model import (
    BridgeFindings,
    Endpoint,
    FoundComponent,
    FoundPort,
    MessageStructure,
    Role,
)
from uoarm.testing import MemoryBridge, patience, wait

IMAGE = closed(pixels={"type": "integer"})
EMPTY = "version: 1\nbridges: {lab: {plugin: memory}}\nfunctions: {}\n"


@pytest.fixture(autouse=True)
def _hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uoarm._resolve._discovery._EVERY_SECONDS", 0.05)
    monkeypatch.setattr("uoarm._resolve._discovery._SETTLE_SECONDS", 0.0)


def follower(
    manager: RobotManager, lines: list[str], *, unfed: tuple[str, ...] = (), as_json: bool = False
) -> _up._Follower:
    def echo(line: str) -> None:
        lines.append(unstyle(line))

    return _up._Follower(manager, unfed=unfed, as_json=as_json, echo=echo)


def look_until(looking: _up._Follower, lines: list[str], expected: str) -> None:
    """Look again until a line says something; candidates come in rounds of their own."""

    def is_printed() -> bool:
        looking.look()
        return any(expected in line for line in lines)

    wait(is_printed)


def test_what_appears_is_a_function_that_is_fed_by_what_fits_and_runs() -> None:
    lab, lines = MemoryBridge("lab", {}), list[str]()
    with RobotManager(loads(EMPTY), bridges={"lab": lab}) as manager:
        looking = follower(manager, lines)
        lab.loop("faceDetection", IMAGE)
        looking.look()
        assert "+ lab  faceDetection" in lines
        assert lines[-1] == (
            "faceDetection  unavailable: no function feeds its input default, "
            "which `unfed` does not name"
        )

        camera = lab.emitter("camera", IMAGE)
        look_until(looking, lines, "-> faceDetection@lab/faceDetection")
        assert "faceDetection  camera@lab/camera -> faceDetection@lab/faceDetection" in lines
        faces = manager.request("faceDetection")
        camera.emit({"pixels": 7})
        assert faces.get(timeout=patience()) == {"pixels": 7}

        before, revision = len(lines), manager.revision
        looking.look()
        assert (len(lines), manager.revision) == (before, revision)


def test_an_input_that_may_stay_without_a_feed_keeps_its_component_from_nothing() -> None:
    lab, lines = MemoryBridge("lab", {}), list[str]()
    lab.loop("base", IMAGE)
    with RobotManager(loads(EMPTY), bridges={"lab": lab}) as manager:
        looking = follower(manager, lines, unfed=("def*",))
        look_until(looking, lines, "base@lab/base")
        assert lines[-1] == "base  base@lab/base"
        revision = manager.revision
        looking.look()
        assert manager.revision == revision


def test_a_plugin_that_cannot_go_without_options_says_which_a_file_must_give() -> None:
    registry = Registry([])
    schema = {"type": "object", "properties": {"url": {}, "port": {}}, "required": ["url", "port"]}
    registry.add(BridgeType("memory", "", MemoryBridge, bridge_options=schema, contract=2))
    with RobotManager(loads(EMPTY), registry=registry) as manager:
        [lab] = manager.discover()
    needs = "plugin 'memory' needs the options url, port, which a file gives under `bridges`"
    line = 'lab: {plugin: memory, options: {"url": "...", "port": "..."}}'
    assert lab.cause == f"bridge 'lab': {needs}, such as {line}"


def test_as_json_each_change_is_a_line() -> None:
    lab, lines = MemoryBridge("lab", {}), list[str]()
    lab.emitter("camera", IMAGE)
    with RobotManager(loads(EMPTY), bridges={"lab": lab}) as manager:
        looking = follower(manager, lines, as_json=True)
        look_until(looking, lines, "@lab/camera")
    expected = json.loads(lines[-1])
    assert expected["functions"] == {"camera": "camera@lab/camera"}
    assert [component["name"] for component in expected["findings"][0]["components"]] == ["camera"]
    with pytest.raises(ConnectionClosedError):
        looking.look()


def test_what_is_named_and_what_has_its_function_already_gets_no_other() -> None:
    lab = MemoryBridge("lab", {})
    lab.emitter("camera", IMAGE)
    lab.emitter("head/eye[1]", IMAGE)
    lab.service("double", {"type": "integer"}, {"type": "integer"}, lambda one: 2 * one)
    named = "{camera: {components: [{name: eye, bridge: lab, output: {endpoint: [camera]}}]}}"
    robot = loads(EMPTY.replace("{}\n", f"{named}\n"))
    with RobotManager(robot, bridges={"lab": lab}) as manager:
        grown = add_functions(robot, manager.discover())
        assert list(grown.functions) == ["camera", "double", "head_eye_1"]
        assert grown.functions["camera"] == robot.functions["camera"]
        manager.apply(grown)
        assert manager.resolve("head_eye_1").provider.component.name == "head_eye_1@lab/head/eye[1]"
        assert manager.call("double", 4) == 8
        assert add_functions(grown, manager.discover()) is grown


def test_what_is_about_a_component_itself_is_no_function() -> None:
    said = MessageStructure({"type": "integer"})
    ports = tuple(
        FoundPort(Endpoint("lab", "arm", Role.SERVICE, ("arm", name), port=name), None, said, said)
        for name in ("grip", "@lifecycle", "@configuration")
    )
    found = BridgeFindings("lab", "memory", (FoundComponent("arm", ports),))
    grown = add_functions(loads(EMPTY), [found])
    assert list(grown.functions) == ["arm_grip"]
    need = grown.functions["arm_grip"].needs
    assert need is not None
    assert need.ports == ("grip",)


def test_the_command_serves_until_it_is_asked_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    registry, lab, serving = Registry(()), MemoryBridge("lab", {}), threading.Event()
    registry.add(BridgeType("memory", "", lambda *_: lab, contract=2))
    lab.emitter("camera", IMAGE)
    look = _up._Follower.look

    def say_so(*given: object, **more: object) -> None:
        say(*given, **more)  # type: ignore[arg-type]
        serving.set()

    def look_and_end(one: _up._Follower) -> None:
        assert serving.wait(patience())
        look(one)
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(_up, "Registry", lambda: registry)
    monkeypatch.setattr(_up, "say", say_so)
    monkeypatch.setattr(_up._Follower, "look", look_and_end)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    file = tmp_path / "robot.yaml"
    file.write_text(EMPTY, encoding="utf-8")
    arguments = ["up", "-f", str(file), "--port", "0", "--every", "100", "--unfed", "*"]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 0, done.output
    assert "serving ws://127.0.0.1:" in done.output
    assert "+ lab  camera  output  camera" in done.output


def test_looking_goes_on_after_anything_that_a_plugin_raises_and_says_it_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines, looks = list[str](), list[int]()
    with RobotManager(loads(EMPTY), bridges={"lab": MemoryBridge("lab", {})}) as manager:
        looking = follower(manager, lines)

        def look() -> None:
            looks.append(1)
            if len(looks) <= 3:
                sys.exit(3)

        looking.look = look  # type: ignore[method-assign]
        with _up._following(looking, 0.001):
            wait(lambda: len(looks) > 3, "it looks no more")
    assert capsys.readouterr().err == "looking for components failed: SystemExit: 3\n"


@pytest.mark.parametrize("is_full", [False, True])
def test_it_ends_where_nothing_more_can_be_printed(*, is_full: bool) -> None:
    read, write = os.pipe()
    os.close(read)
    if is_full:
        os.close(write)
        write = os.open("/dev/full", os.O_WRONLY)
    ended = threading.Event()

    def end(*_: object) -> None:
        ended.set()
        if is_full:  # as before the server takes the signal
            sys.exit(143)

    former = signal.signal(signal.SIGTERM, end)

    def echo(line: str) -> None:
        os.write(write, line.encode())

    lab = MemoryBridge("lab", {})
    lab.emitter("camera", IMAGE)
    try:
        with RobotManager(loads(EMPTY), bridges={"lab": lab}) as manager:
            looking = _up._Follower(manager, as_json=False, echo=echo)
            with (
                pytest.raises(OSError, match="No space" if is_full else "Broken pipe"),
                _up._following(looking, 0.001),
            ):
                wait(ended.is_set)
    finally:
        signal.signal(signal.SIGTERM, former)
        os.close(write)
