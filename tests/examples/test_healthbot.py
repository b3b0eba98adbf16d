"""The HealthBot: both applications at once on one robot of three frameworks, and a clean end."""

from __future__ import annotations

import json
import os
import re
import signal
import string
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.examples.healthbot import EXAMPLE, Scene, terminal_visit
from tests.processes import lives
from tests.server.browser import Browser, find_chromium
from vision_demo.footage import Footage
from websockets.sync.client import connect

from uoarm import ResolutionError, RobotManager
from uoarm.config import load, loads
from uoarm.model import Component, Robot
from uoarm.testing import patience, wait

# The harness gives them all to one worker: one scene, which the last of them ends.
CHROMIUM = find_chromium()
PROMPT = "(document.getElementById('prompt')?.textContent ?? '')"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    scene = Scene(tmp_path_factory.mktemp("healthbot"))
    yield scene
    scene.close()


def asked(robot: str, op: str, name: str = "") -> Any:
    """The reply to one question to the robot."""
    with connect(robot, max_size=None) as socket:
        socket.recv(timeout=patience())
        socket.send(json.dumps({"op": op, "id": "1"} | ({"type": name} if name else {})))
        answer = json.loads(socket.recv(timeout=patience()))
    assert answer["op"] == "Reply", answer
    return answer["jsonMessage"]


def shown(browser: Browser, beginning: str, picture: Path) -> None:
    """Wait for a prompt however slow the machine is, and keep a picture of it."""
    browser.until(f"{PROMPT}.startsWith({json.dumps(beginning)})")
    browser.picture(picture)


def chosen(browser: Browser, label: str) -> None:
    """Choose with the keyboard alone: Tab from the prompt to the button, then Enter."""
    browser.until("document.querySelector('#choices button')")
    for _ in range(4):
        browser.press("Tab")
        if browser.js("document.activeElement.textContent") == label:
            browser.press("Enter")
            return
    raise AssertionError(f"Tab never reaches {label!r}")


def records(url: str) -> list[str]:
    with urllib.request.urlopen(f"{url}/Observation?patient=franck", timeout=patience()) as answer:
        bundle = json.load(answer)
    return [json.dumps(entry["resource"]["code"]) for entry in bundle.get("entry", [])]


def test_three_frameworks_feed_one_function(scene: Scene) -> None:
    plan = asked(scene.robot, "Resolve", "faceRecognition")["text"]
    names = re.findall(r"^ +\d\. \w+: (\w+) \((\w+),", plan, re.MULTILINE)
    assert names == [
        ("ros_camera", "ros"),
        ("rtm_detector", "rtm"),
        ("network_recogniser", "parts"),
    ]


def ports(component: Component) -> list[tuple[str, ...]]:
    """What a component provides a function with, but for how its framework spells a type."""
    ends = [output.endpoint for output in component.outputs]
    ends += [component.service.endpoint] if component.service is not None else []
    return [(component.bridge, *endpoint.address[:2]) for endpoint in ends]


def test_a_line_of_needs_for_each_function_chooses_what_the_written_file_chooses(
    scene: Scene,
) -> None:
    written = load(scene.run / "robot.yaml")
    template = string.Template((EXAMPLE / "needs.yaml").read_text(encoding="utf-8"))
    tree = yaml.safe_load(template.safe_substitute(here=EXAMPLE, run=scene.run))
    filled_in = yaml.safe_load((scene.run / "robot.yaml").read_text(encoding="utf-8"))
    for name in ("ros", "rtm"):
        tree["bridges"][name] = filled_in["bridges"][name]
    assert all(list(item) == ["needs"] for item in tree["functions"].values())
    wanted = {
        name: [ports(component) for component in function.components]
        for name, function in written.functions.items()
    }
    with RobotManager(loads(yaml.safe_dump(tree), str(scene.run / "needs.yaml"))) as robot:

        def candidates() -> dict[str, list[list[tuple[str, ...]]]]:
            found = robot.config.functions
            return {
                name: [ports(component) for component in found[name].components] for name in wanted
            }

        with suppress(ResolutionError):  # bridges are asked from the first question on
            robot.resolve("camera")
        wait(lambda: candidates() == wanted, "others are found than are written")
        for name in ("faceRecognition", "speechGeneration", "patientRecord"):
            served = asked(scene.robot, "Resolve", name)["plan"]["steps"]
            chosen = [written_name(step.component, written) for step in robot.resolve(name).steps]
            assert chosen == [item["component"]["name"] for item in served]


def written_name(component: Component, written: Robot) -> str:
    """Return the name that the written file has for a component without a name."""
    return next(item.name for item in written.components() if ports(item) == ports(component))


@pytest.mark.needs("node", "chromium")
def test_both_applications_work_at_once(scene: Scene, footage: Footage, tmp_path: Path) -> None:
    assert CHROMIUM is not None
    if "1-franck.mp4" not in footage.expected:
        pytest.skip(f"the patient is Franck: {footage.remark}")
    with terminal_visit(scene.robot) as terminal:
        try:
            with Browser(CHROMIUM) as browser:
                browser.show(1280, 800)
                browser.go(scene.page)
                shown(browser, "Hello Franck", tmp_path / "1-hello.png")
                chosen(browser, "Start")
                shown(browser, "Put your finger", tmp_path / "2-finger.png")
                chosen(browser, "My finger is in")
                shown(browser, "Put the cuff", tmp_path / "3-arm.png")
                chosen(browser, "The cuff is on")
                shown(browser, "Thank you", tmp_path / "4-results.png")
                report = browser.js("document.getElementById('values').innerText")
                assert not browser.complaints
            said, _ = terminal.communicate()
        finally:
            terminal.kill()
    assert terminal.returncode == 0, said
    assert "Hello Franck" in said
    assert len(re.findall(r"stored$", said, re.MULTILINE)) == 3
    assert report.count("saved") == 3
    assert re.search(r"\d\d\d / \d\d", report)
    status = asked(scene.robot, "Status")
    assert not status["connections"], "what both have left is closed"
    codes = records(re.findall(r"records at (\S+)", (scene.run / "records.log").read_text())[0])
    # pulse, saturation and blood pressure, by their LOINC codes, from each application
    for code in ("8867-4", "59408-5", "85354-9"):
        assert sum(code in name for name in codes) == 2, codes


def test_a_spare_takes_over_in_mid_stream(scene: Scene) -> None:
    with connect(scene.robot, max_size=None) as socket:
        socket.recv(timeout=patience())
        socket.send(json.dumps({"op": "Request", "type": "faceDetection", "id": "1"}))
        report = json.loads(socket.recv(timeout=patience()))
        assert report["jsonMessage"]["components"] == ["ros_camera", "rtm_detector"]
        for _ in range(3):
            assert json.loads(socket.recv(timeout=patience()))["op"] == "Data"
        os.kill(scene.pids["detector"], signal.SIGKILL)

        def taken_over() -> bool:
            connection = asked(scene.robot, "Status")["connections"][0]
            return bool(connection["components"][-1] == "plain_detector")

        wait(taken_over, "the spare never took over")
        numbers: list[int] = []
        while len(numbers) < 3 or numbers[-1] < numbers[0] + 10:
            report = json.loads(socket.recv(timeout=patience()))
            assert report["op"] == "Data", report
            numbers.append(report["x-number"])
    wait(lambda: "detector ended" in scene.output, "the scene does not report the death")


def test_ctrl_c_leaves_nothing_behind(scene: Scene) -> None:
    pids = scene.pids
    assert len(pids) == 10
    assert lives(pids["robot"])
    assert scene.interrupt() == 0
    assert not any(map(lives, pids.values()))
    assert "Everything is ended" in scene.output


def test_the_page_shares_no_code_with_the_terminal() -> None:
    def names(folder: str) -> set[str]:
        return {file.name for file in (EXAMPLE / folder).iterdir()}

    for file in (EXAMPLE / "browser").glob("*.js"):
        assert "terminal" not in file.read_text()
    assert names("browser") & names("terminal") == set()
