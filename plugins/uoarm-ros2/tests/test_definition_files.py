"""Definitions read without ROS: the very structures that the installed types have."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from endpoints import write
from uoarm_ros2._types import (
    describe_action,
    describe_service,
    import_type,
    shape_of,
    structure_of,
    type_hash,
)
from uoarm_ros2.definitions import DefinitionReader, RosDefinitions, read_definitions

from uoarm.errors import ConfigurationError
from uoarm.model import MessageStructure

pytest.importorskip("rosbags", reason=".idl files are read with rosbags: uoarm-ros2[definitions]")


IDL = ("BasicTypes", "Constants", "Defaults", "Empty", "Nested", "Strings", "WStrings")
"""Definitions of every sort; an `.idl` takes the parser a tenth of a second."""


@pytest.fixture(scope="module")
def found(share: Path) -> RosDefinitions:
    return read_definitions(share)


def described(name: str) -> MessageStructure | None:
    """Return what the bridge says of an installed type, or of a part of one."""
    if "/msg/" in name:
        return structure_of(shape_of(import_type(name), name))
    whole, part = name.rsplit("_", 1)
    if "/action/" in name:
        native: Any = import_type(whole)
        return structure_of(shape_of(getattr(native, part), name))
    description = describe_service(whole)
    return description.request if part == "Request" else description.reply


def test_every_installed_type_has_the_structure_that_the_bridge_describes(
    found: RosDefinitions,
) -> None:
    assert not found.problems
    assert {"test_msgs/msg/WStrings", "sensor_msgs/msg/Imu"} < found.structures.keys()
    assert {name.split("/")[1] for name in found.structures} == {"msg", "srv", "action"}
    wrong = [name for name, structure in found.structures.items() if structure != described(name)]
    assert not wrong


def test_goals_and_results_of_an_action_are_those_that_the_bridge_describes(
    found: RosDefinitions,
) -> None:
    description = describe_action("test_msgs/action/Fibonacci")
    assert found.structures["test_msgs/action/Fibonacci_Goal"] == description.request
    assert found.structures["test_msgs/action/Fibonacci_Result"] == description.reply


def test_idl_alone_says_the_same_but_for_defaults(
    share: Path, found: RosDefinitions, tmp_path: Path
) -> None:
    names = {f"test_msgs/msg/{name}" for name in IDL}
    for name in names:
        copy = tmp_path / f"{name}.idl"
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(share / f"{name}.idl", copy)
    alone = read_definitions(tmp_path)
    assert not alone.problems
    assert {name: bare(structure.schema) for name, structure in alone.structures.items()} == {
        name: bare(found.structures[name].schema) for name in names
    }


def bare(schema: Any) -> Any:
    if isinstance(schema, dict):
        return {name: bare(value) for name, value in schema.items() if name != "default"}
    return [bare(item) for item in schema] if isinstance(schema, list) else schema


def test_texts_are_read_as_they_are_written(tmp_path: Path) -> None:
    write(
        tmp_path,
        p__msg__Texts='string A=12  # a comment\nstring B="it # is"\nbool C=1\nfloat32 D=1\n'
        "wstring<=5 wide\nstring<=3[<=2] many\nstring named 1.10\n",
    )
    schema: Any = read_definitions(tmp_path).structures["p/msg/Texts"].schema
    assert schema["x-constants"] == {"A": "12", "B": '"it', "C": True, "D": 1.0}
    assert isinstance(schema["x-constants"]["C"], bool)
    assert schema["properties"]["wide"] == {
        "type": "string", "maxLength": 5, "x-max-utf16": 5, "x-nul": False,
        "x-native-type": "wstring",
    }  # fmt: skip
    assert schema["properties"]["named"]["default"] == "1.10"
    assert schema["properties"]["many"]["maxItems"] == 2


def test_what_cannot_be_read_is_a_problem_and_the_rest_is_read(tmp_path: Path) -> None:
    write(
        tmp_path,
        p__msg__Good="int8 a\n",
        p__msg__Missing="q/Absent a\n",
        p__msg__Holds="Missing a\n",
        p__msg__Itself="Itself[] a\n",
        p__msg__Double="int8 a\nint16 a\n",
        p__msg__Wrong="not ? a definition\n",
        p__srv__One="int8 a\n",
    )
    (tmp_path / "p" / "msg" / "Octets.msg").write_bytes(b"\xff\xfe")
    os.mkfifo(tmp_path / "p" / "msg" / "Pipe.msg")
    doubling = {f"p__msg__D{n}": f"D{n + 1} a\nD{n + 1} b\n" for n in range(30)}
    write(tmp_path, **doubling, p__msg__D30="int8 a\n")
    found = read_definitions(tmp_path)
    assert "p/msg/Good" in found.structures
    assert "q/msg/Absent is not defined" in found.problems["p/msg/Missing"]
    assert "q/msg/Absent is not defined" in found.problems["p/msg/Holds"]
    assert "nested more than" in found.problems["p/msg/Itself"]
    assert "more than 20,000 fields" in found.problems["p/msg/D0"]
    by_file = {Path(name).name: text for name, text in found.problems.items()}
    assert {"Wrong.msg", "Octets.msg", "One.srv", "Double.msg"} <= by_file.keys()
    assert by_file["Pipe.msg"] == "no regular file"
    assert by_file["Double.msg"] == "line 2: 'int16 a': line 1 defines a already"
    assert "1 parts between lines of ---, not 2" in by_file["One.srv"]


def test_the_last_folder_wins(tmp_path: Path) -> None:
    old = write(tmp_path / "old", p__msg__A="int8 a\n")
    new = write(tmp_path / "new", p__msg__A="int16 a\n")
    assert read_definitions(old, new) == read_definitions(new)
    assert read_definitions(new, old) == read_definitions(old)


def test_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="is no folder of ROS definitions"):
        read_definitions(tmp_path / "none")


IDL_TEXT = """module p {{ module msg {{
  module A_Constants {{ {constants} }};
  struct A {{ {fields} }};
}}; }};"""


def idl(folder: Path, constants: str, fields: str = "long a;") -> RosDefinitions:
    path = folder / "p" / "msg" / "A.idl"
    path.parent.mkdir(parents=True)
    path.write_text(IDL_TEXT.format(constants=constants, fields=fields), encoding="utf-8")
    return read_definitions(folder)


@pytest.mark.parametrize(
    ("constants", "fields", "words"),
    [
        ("const uint8 X = 300;", "long a;", "constant X: expected a value of uint8, 0 to 255"),
        ("const octet X = -1;", "long a;", "constant X: expected a value of byte"),
        ('const long X = "a";', "long a;", "constant X: expected a value of int32"),
        ("const string X = 3;", "long a;", "constant X: expected a value of string"),
        ("const boolean X = 1;", "long a;", "constant X: expected a value of bool"),
        ("const long X = 1; const long X = 2;", "long a;", "two constants are called X"),
        ("const long X = 1;", "long a; short a;", "two fields are called a"),
    ],
)
def test_values_of_idl_files_are_checked_by_their_type(
    tmp_path: Path, constants: str, fields: str, words: str
) -> None:
    found = idl(tmp_path, constants, fields)
    assert not found.structures
    (problem,) = found.problems.values()
    assert words in problem


def test_constants_of_idl_files_are_read_as_idl_has_them(tmp_path: Path) -> None:
    constants = 'const long A = 010; const float B = 1; const string C = "010";'
    schema: Any = idl(tmp_path, constants).structures["p/msg/A"].schema
    assert schema["x-constants"] == {"A": 8, "B": 1.0, "C": "010"}


def test_a_character_of_an_idl_file_is_none_of_a_message_file(tmp_path: Path) -> None:
    idl(tmp_path, "const long A = 1;", "char letter;")
    reading = DefinitionReader()
    reading.take(tmp_path)
    digits = "4b7caf429aa0d57c9e1d9465f027fdec930c22db8f48c1c0c66a2bde34c33711"
    assert type_hash(reading.record("p/msg/A")) == f"RIHS01_{digits}", "as rosidl has it"


def test_without_the_extra_msg_files_are_read_and_idl_files_say_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.typesys.idl", None)
    found = idl(write(tmp_path, q__msg__B="int8 a\n"), "const long X = 1;")
    assert set(found.structures) == {"q/msg/B"}
    (problem,) = found.problems.values()
    assert "uoarm-ros2" in problem
