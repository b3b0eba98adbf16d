"""The example runs in its three commands, and its mistake is refused with what to paste."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from tests.domains import reserved_domain  # type: ignore[import-not-found]
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_rtm._options import BufferOptions, RtmBridgeOptions, RtmEndpointOptions
from uoarm_rtm.component import NamingService, Orb

from uoarm._control import RobotManager
from uoarm.bridge import options_table
from uoarm.errors import ResolutionError
from uoarm.testing import patience

EXAMPLES = Path(__file__).parents[3] / "examples"
ROS = importlib.util.find_spec("rclpy") is not None and importlib.util.find_spec("uoarm_ros2")
MAPPED = "map: {text: data}"


@contextmanager
def program(*command: str) -> Iterator[subprocess.Popen[str]]:
    """Run a program of the example until it has said its first line, then for a while."""
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()


@pytest.fixture
def domain() -> Iterator[int]:
    with reserved_domain() as found:
        yield found


@pytest.fixture
def address() -> Iterator[str]:
    """A naming service, started as the page says."""
    with program("-m", "uoarm_rtm", "nameserver", "--port", "0") as server:
        assert server.stdout is not None
        line = server.stdout.readline()
        assert line.startswith("naming service corbaloc:iiop:127.0.0.1:")
        yield line.split(":", 2)[2].removesuffix("/NameService\n")


def configuration(address: str, tmp_path: Path) -> Path:
    file = Path(shutil.copytree(EXAMPLES / "rtm", tmp_path / "rtm")) / "robot.yaml"
    file.write_text(file.read_text().replace("localhost:2809", address))
    return file


def say(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def test_a_component_started_by_hand_is_received(address: str, tmp_path: Path) -> None:
    with program("-u", str(EXAMPLES / "rtm" / "counter.py"), address) as counter:
        assert say(counter) == "Counter0.rtc counts\n"
        with (
            RobotManager.from_file(configuration(address, tmp_path)) as robot,
            robot.request("counter", validate="always") as numbers,
        ):
            one, two = numbers.get(timeout=patience()), numbers.get(timeout=patience())
            assert two["data"] == one["data"] + 1


@pytest.mark.parametrize("name", ["counter", "parrot"])
def test_a_component_that_is_ended_leaves_the_naming_service(address: str, name: str) -> None:
    program_file = str(EXAMPLES / "rtm" / f"{name}.py")
    with program("-u", program_file, address) as component:
        assert say(component)
        component.terminate()
        assert component.wait(patience()) == 0
    with closing(Orb("127.0.0.1", call_seconds=patience())) as orb:
        assert not NamingService(orb, address, seconds=patience()).names()
    done = run_python(program_file, "127.0.0.1:1")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1, done.stderr


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # lark, inside ROS 2
@pytest.mark.skipif(not ROS, reason="needs uoarm-ros2[jazzy] beside")
def test_a_chain_through_ros_and_rtc_and_its_refusal(
    address: str, domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    file = configuration(address, tmp_path)
    with (
        program("-u", str(EXAMPLES / "rtm" / "parrot.py"), address) as parrot,
        program(str(EXAMPLES / "ros2" / "talker.py")) as talker,
    ):
        assert say(parrot) == "Parrot0.rtc listens\n"
        assert say(talker) == "talking on /chatter\n"
        with (
            RobotManager.from_file(file) as robot,
            robot.request("parrot", validate="always") as said,
        ):
            words = said.get(timeout=patience())["text"].split(", ")
            assert words[0] == words[1]
            assert words[0].startswith("hello ")
        assert MAPPED in file.read_text()
        file.write_text(file.read_text().replace(MAPPED, ""))
        with (
            RobotManager.from_file(file) as robot,
            pytest.raises(ResolutionError, match=r"(?s)'text' is required .* map: {text: data}"),
        ):
            robot.request("parrot")


def test_the_tables_of_options_are_what_the_plugin_declares() -> None:
    page = (EXAMPLES.parent / "docs" / "rtm.md").read_text(encoding="utf-8")
    assert options_table(RtmEndpointOptions.schema()) in page
    assert options_table(RtmBridgeOptions.schema()) in page
    assert options_table(BufferOptions.schema(), "member") in page
