"""Types from folders of definitions, `options: {definitions: [...]}`: not installed, yet talked."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from endpoints import Make, Start, endpoint, known, sink, source, write
from messages import same
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2._type_finder import DefinedTypes
from uoarm_ros2._types import import_type, shape_of, structure_of, type_hash
from uoarm_ros2.definitions import DefinitionReader

from uoarm.bridge import Registry
from uoarm.errors import BridgeError, ConfigurationError, MessageError
from uoarm.model import Role
from uoarm.testing import patience

MakeBridge = Make
MADE = {"boolean": True, "integer": 3, "number": 0.25}


@pytest.fixture
def uninstall(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Makes a package as if it were not installed here; peers have it."""

    def uninstall(package: str) -> None:
        for name in [module for module in sys.modules if module.split(".")[0] == package]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, package, None)

    return uninstall


@pytest.fixture
def own(share: Path, tmp_path: Path) -> Path:
    """A folder with the definitions of test_msgs, as a lab's own."""
    shutil.copytree(share / "test_msgs" / "msg", tmp_path / "own" / "test_msgs" / "msg")
    return tmp_path / "own"


def hashes(share: Path) -> dict[str, str]:
    """Return what `rosidl` wrote for every message type that is installed."""
    found: dict[str, str] = {}
    for path in sorted(share.glob("*/msg/*.json")):
        for hash_ in json.loads(path.read_text())["type_hashes"]:
            found[hash_["type_name"]] = hash_["hash_string"]
    return found


def test_every_installed_type_has_the_hash_that_rosidl_wrote(share: Path) -> None:
    wanted = hashes(share)
    assert {"test_msgs/msg/Empty", "test_msgs/msg/WStrings", "nav_msgs/msg/Path"} < wanted.keys()
    reading = DefinitionReader()
    reading.take(share)
    assert {name: type_hash(reading.record(name)) for name in wanted} == wanted
    assert {name: type_hash(shape_of(import_type(name), name)) for name in wanted} == wanted


def test_a_folder_gives_the_very_structure_and_takes_what_it_refers_to_from_what_is_installed(
    share: Path, tmp_path: Path, uninstall: Callable[[str], None]
) -> None:
    name = "sensor_msgs/msg/BatteryState"
    before = structure_of(shape_of(import_type(name), name))
    shutil.copytree(share / "sensor_msgs" / "msg", tmp_path / "sensor_msgs" / "msg")
    uninstall("sensor_msgs")
    native = DefinedTypes([str(tmp_path)]).find(name)
    assert native is not None
    assert structure_of(shape_of(native, name)) == before
    assert "x-constants" in str(before.schema)
    assert type_hash(shape_of(native, name)) == hashes(share)[name]
    assert DefinedTypes([]).find(name) is None


def test_a_type_that_no_node_describes_is_talked_both_ways(
    make_bridge: MakeBridge,
    peer: Start,
    own: Path,
    uninstall: Callable[[str], None],
) -> None:
    uninstall("test_msgs")
    there = peer("there", "threads", "silent")
    there.do("pass_on", come="/come", go="/go", kind="UnboundedSequences")
    bridge = make_bridge(definitions=[str(own)])
    known(bridge, "/there")
    at = endpoint(Role.INPUT, "/come", "test_msgs/msg/UnboundedSequences")
    inbox = Inbox()
    source(bridge, endpoint(Role.OUTPUT, "/go"), inbox)
    out = sink(bridge, at)
    structure = bridge.describe(at).message
    assert structure is not None
    schema: Any = structure.schema
    fields = schema["properties"]
    assert fields["int8_values_default"]["default"] == [0, 127, -128]
    basic = {name: MADE[kind["type"]] for name, kind in _nested(fields).items()}
    message = {name: [] for name in fields} | {
        "alignment_check": 7,
        "string_values": ["a", "\N{SNOWMAN}"],
        "float64_values": [0.5],
        "basic_types_values": [basic, basic],
    }
    out.send(message)
    assert same(inbox.wait_for(1)[0], message)
    with pytest.raises(MessageError, match="alignment_check"):
        out.send({**message, "alignment_check": "seven"})
    ends = bridge._runner.ends("/come")  # type: ignore[attr-defined]  # both, as DDS has them
    assert len({item.definition for item in ends}) == 1 < len(ends)
    (found,) = [component for component in bridge.discover() if component.name == "/there"]
    assert {item.port for item, report in found.endpoints if report.message} >= {"come", "go"}


def _nested(fields: Any) -> Any:
    return fields["basic_types_values"]["items"]["properties"]


def test_a_folder_of_another_version_than_the_node_has_is_refused(
    make_bridge: MakeBridge,
    peer: Start,
    own: Path,
    uninstall: Callable[[str], None],
) -> None:
    uninstall("test_msgs")
    with (own / "test_msgs" / "msg" / "Strings.msg").open("a") as file:
        file.write("\nint8 newer\n")
    there = peer("there", "threads")
    there.do("pass_on", come="/come", go="/go", kind="Strings")
    bridge = make_bridge(definitions=[str(own)])
    at = endpoint(Role.INPUT, "/come", "test_msgs/msg/Strings", wait=min(patience(), 60))
    with pytest.raises(BridgeError, match="defined otherwise there than here: /there has RIHS01_"):
        sink(bridge, at)


def test_a_type_that_holds_what_is_nowhere_names_file_and_line(tmp_path: Path) -> None:
    folder = str(write(tmp_path, p__msg__Holds="int8 a\n\nq/Absent what  # of another package\n"))
    with pytest.raises(BridgeError, match=r"Holds\.msg: line 3: q/msg/Absent is not defined"):
        DefinedTypes([folder]).find("p/msg/Holds")


@pytest.mark.parametrize(
    ("files", "name", "words"),
    [
        (
            {"p__msg__Wrong": "int8 a\n# more\nfloat9! b\nint8 c\n"},
            "p/msg/Wrong",
            r"Wrong\.msg: line 3: 'float9",
        ),
        ({"p__srv__One": "int8 a\n"}, "p/srv/One_Request", r"One\.srv: 1 parts between lines"),
        (
            {"p__msg__Wrong": "uint8 a 300\n", "p__msg__Holds": "int8 a\nWrong b\n"},
            "p/msg/Holds",
            (
                r"Holds\.msg: line 2: p/msg/Wrong cannot be read: .*Wrong\.msg: line 1: "
                r"'uint8 a 300': expected a whole number from 0 to 255, got '300'"
            ),
        ),
    ],
)
def test_a_broken_file_costs_its_own_types_and_what_holds_them(
    make_bridge: MakeBridge, tmp_path: Path, files: dict[str, str], name: str, words: str
) -> None:
    folder = str(write(tmp_path, p__msg__Good="int8 a\nstring NONE=\n", **files))
    bridge = make_bridge(definitions=[folder])
    optional = endpoint(Role.INPUT, "/good", "p/msg/Good", peer="optional")
    assert bridge.describe(optional).message is not None
    with pytest.raises(
        BridgeError, match=f"as option definitions has it, cannot be used: .*{words}"
    ):
        DefinedTypes([folder]).find(name)


def test_a_type_of_two_folders_costs_itself_and_a_folder_that_is_none_is_refused(
    make_bridge: MakeBridge, tmp_path: Path
) -> None:
    one = str(write(tmp_path / "one", p__msg__A="int8 a\n", p__msg__B="int8 a\n"))
    other = str(write(tmp_path / "other", p__msg__A="int16 a\n", p__msg__C="A a\n"))
    types = DefinedTypes([one, other])
    assert types.find("p/msg/B") is not None
    for name in ("p/msg/A", "p/msg/C"):
        with pytest.raises(BridgeError, match=r"it is in .*one.* and in .*other"):
            types.find(name)
    for name in ("none", "long" * 100):
        with pytest.raises(ConfigurationError, match=rf"{name} is no folder of ROS definitions"):
            make_bridge(definitions=[str(tmp_path / name)])


def test_paths_begin_at_the_configuration() -> None:
    located = Registry().types["ros2"].located
    assert located({"definitions": ["src/msgs", "/opt/msgs"]}, "/robot") == {
        "definitions": ["/robot/src/msgs", "/opt/msgs"]
    }
