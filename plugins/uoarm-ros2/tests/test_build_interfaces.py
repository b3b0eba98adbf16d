"""`uoarm ros2 build-interfaces`: a lab's own messages as wheels, by the wheels' own generators."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from endpoints import Make, endpoint, source
from peers import own_line
from tests.inbox import Inbox  # type: ignore[import-not-found]
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_ros2._interface_sources import in_build_order, packages_in
from uoarm_ros2._interface_wheels import write_wheel

from uoarm.bridge import Bridge
from uoarm.cli import main
from uoarm.errors import ConfigurationError
from uoarm.model import Role
from uoarm.testing import patience

HERE = Path(__file__).parent
GRIP = """# how the claw grips
uint8 OPEN=0
uint8 CLOSED=1
std_msgs/Header header
float64 force 0.5  # newtons
string<=8 name "left"
arm_msgs/Joint[<=3] joints
wstring wide
"""
DEFINITIONS = {
    "claw_msgs/msg/Grip.msg": GRIP,
    "claw_msgs/srv/Take.srv": "Grip wanted\n---\nbool success\nstring message\n",
    "claw_msgs/action/Squeeze.action": "float64 force\n---\nbool done\n---\nfloat64 force\n",
    "arm_msgs/msg/Joint.msg": "float32[3] angles\nstring[] labels\n",
    "arm_msgs/package.xml": "<package><name>arm_msgs</name><version>1.2.3</version></package>",
}


def run(*words: str) -> int:
    """Run `uoarm ros2`; return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main(["ros2", *words])
    return int(ended.value.code or 0)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes files by their paths; returns the folder."""

    def write_them(files: dict[str, str]) -> Path:
        for name, text in files.items():
            path = tmp_path / "src" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path / "src"

    return write_them


@pytest.mark.parametrize(
    ("files", "text"),
    [
        ({}, "is no folder"),
        ({"claw_msgs/README": ""}, "has no definitions: expected package/msg/Name.msg"),
        ({"Claw/msg/Grip.msg": "bool a"}, "'Claw' is no name of a ROS package"),
        ({f"{'claw' * 20}-old/msg/Grip.msg": "bool a"}, "-old' is no name of a ROS package"),
        ({"claw_msgs/msg/grip.msg": "bool a"}, "'grip' is no name of a type"),
        ({"a/claw/msg/A.msg": "bool a", "b/claw/msg/A.msg": ""}, "package claw is there twice"),
        ({"claw/msg/Grip.msg": "bool\n"}, "Grip.msg: "),
        ({"claw/msg/Grip.msg": "far_msgs/Far far\n"}, "claw refers to types of far_msgs, which"),
        pytest.param(
            {"claw/msg/Grip.msg": "bool from\n"},
            "_grip.py: self.from = kwargs.get('from', bool())",
            marks=pytest.mark.needs("compiler"),
        ),
        ({"a/msg/A.msg": "b/B b\n", "b/msg/B.msg": "a/A a\n"}, "packages need one another: a, b"),
    ],
)
def test_what_cannot_be_built_is_one_error_with_its_place(
    write: Callable[..., Path],
    files: dict[str, str],
    text: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, output = write(files), tmp_path / "out"
    assert run("build-interfaces", str(folder), "--output", str(output)) == 3
    reports = capsys.readouterr()
    assert text in reports.err
    assert reports.out == ""
    assert not output.exists()


def test_without_a_compiler_it_says_so_before_any_work(
    write: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler -O3")
    assert run("build-interfaces", str(write(DEFINITIONS))) == 4
    text = capsys.readouterr().err
    assert "there is no compiler: none of no-such-compiler is on the path; install gcc" in text
    assert "definitions" not in text.splitlines()[0].partition("there is")[0]


def test_packages_are_built_after_those_that_they_need() -> None:
    needs = {"a": frozenset({"b", "std_msgs"}), "b": frozenset({"c"}), "c": frozenset[str]()}
    assert in_build_order(needs) == ("c", "b", "a")
    with pytest.raises(ConfigurationError, match="need one another: a, b"):
        in_build_order({"a": frozenset({"b"}), "b": frozenset({"a"})})


def test_an_idl_beside_its_source_is_not_a_second_definition(write: Callable[..., Path]) -> None:
    folder = write({"claw/msg/Grip.msg": "bool a\n", "claw/msg/Grip.idl": "", "claw/srv/B.idl": ""})
    (package,) = packages_in(folder / "claw")
    assert [str(file) for file in package.files] == ["msg/Grip.msg", "srv/B.idl"]


def test_a_wheel_has_what_it_records(write: Callable[..., Path], tmp_path: Path) -> None:
    path = write({"x.py": "found = 1\n"}) / "x.py"
    files = {"claw_msgs/__init__.py": path, "data/data/share/claw_msgs/x.py": path}
    wheel = write_wheel(tmp_path, "claw_msgs", "1.0", ("attrs",), files)
    with zipfile.ZipFile(wheel) as archive:
        assert b"Requires-Dist: attrs\n" in archive.read("claw_msgs-1.0.dist-info/METADATA")
        rows = archive.read("claw_msgs-1.0.dist-info/RECORD").decode().splitlines()
        assert {row.split(",")[0] for row in rows} == {*archive.namelist()}
    assert "claw_msgs-1.0.data/data/share/claw_msgs/x.py" in "".join(rows)
    assert not [*tmp_path.glob("*.part")]


def install(target: Path, *wheels: Path) -> None:
    pip = ["-m", "pip", "install", "-q", "--no-deps", "--no-index", "--disable-pip-version-check"]
    done = run_python(*pip, "--target", target, *wheels)
    assert not done.returncode, done.stderr


@pytest.fixture
def claw() -> Iterator[Callable[[Path], None]]:
    """Starts the node that talks claw_msgs, installed in a folder, and ends it."""
    started: list[subprocess.Popen[str]] = []

    def start(target: Path) -> None:
        process = subprocess.Popen(
            [sys.executable, str(HERE / "own_interfaces.py")],
            env={**os.environ, "PYTHONPATH": str(target)},
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout is not None
        assert own_line(process.stdout) == "ready\n"

    yield start
    for process in started:
        process.terminate()
        process.wait(patience())
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.long
def test_a_node_talks_what_was_built(
    write: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    make_bridge: Make,
    claw: Callable[[Path], None],
) -> None:
    """Two packages, one of which holds types of the other, as message, service and action."""
    words = ["build-interfaces", str(write(DEFINITIONS)), "--output", str(tmp_path / "out")]
    assert run(*words, "--json") == 0
    reports = capsys.readouterr()
    wheels = [Path(load) for load in json.loads(reports.out)]
    assert [wheel.name.split("-")[0] for wheel in wheels] == ["arm_msgs", "claw_msgs"]
    assert wheels[0].name.startswith("arm_msgs-1.2.3-cp")
    assert "claw_msgs: compiling" in reports.err
    with zipfile.ZipFile(wheels[1]) as archive:
        assert b"arm-msgs==1.2.3" in archive.read("claw_msgs-0.0.0.dist-info/METADATA")
    target = tmp_path / "target"
    install(target, *wheels)
    claw(target)
    monkeypatch.syspath_prepend(str(target))
    bridge, inbox = make_bridge(), Inbox()
    source(bridge, endpoint(Role.OUTPUT, "/grip", "claw_msgs/msg/Grip"), inbox)
    (grip,) = inbox.wait_for(1)
    assert (grip["force"], grip["name"], grip["wide"]) == (2.5, "left", "ü")
    assert [*grip["joints"][0]["angles"]] == [1.0, 2.0, 3.0]
    reply = call(bridge, "/take", "claw_msgs/srv/Take", {"wanted": grip})
    assert reply == {"success": True, "message": "elbow"}
    assert call(bridge, "/squeeze", "claw_msgs/action/Squeeze", {"force": 3.0}) == {"done": True}


def call(bridge: Bridge, name: str, type_name: str, request: dict[str, object]) -> object:
    at = endpoint(Role.SERVICE, name, type_name)
    return bridge.call(at, request)
