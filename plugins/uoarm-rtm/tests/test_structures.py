"""Message structures: every allowed message can be written, and the facts are exact."""

from __future__ import annotations

import filecmp
import importlib.util
import json
import os
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import _uoarm_rtm_stubs
import pytest
from hypothesis import given
from jsonschema import Draft202012Validator
from messages import messages
from plain import plain
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_rtm._compiler import OUR_IDL, load_idl
from uoarm_rtm._shape import schema_of
from uoarm_rtm._types import Types, derive, idl_of

from uoarm.bridge import Registry, ServiceStructures
from uoarm.config import load
from uoarm.errors import BridgeError
from uoarm.model import MessageStructure
from uoarm.schema import check
from uoarm.testing import instances

HERE = Path(__file__).parent
NAMES = [
    "RTC/TimedLong", "RTC/TimedFloatSeq", "RTC/TimedBooleanSeq", "RTC/CameraImage", "RTC/RangeData",
    "RTC/ActArrayState", "RTC/GPSData", "RTC/Features", "Odd/Mixed", "Odd/Bounded", "Odd/Grid",
    "Odd/Weather", "Odd/Deep", "Odd/Unions",
]  # fmt: skip


def of(**properties: Any) -> dict[str, Any]:
    """Return the schema of an object with all of these."""
    closed = {"required": list(properties), "additionalProperties": False}
    return {"type": "object", "properties": properties, **closed}


@lru_cache
def types() -> Types:
    return Types([str(HERE / "types.idl")])


def json_of(value: Any) -> Any:
    """Return a message as JSON; strings that stand for NaN and infinities stay out."""
    if isinstance(value, dict):
        return {name: json_of(member) for name, member in value.items()}
    return list(map(json_of, value)) if isinstance(value, bytes | list) else value


@pytest.mark.parametrize("name", NAMES)
def test_every_message_of_the_type_is_allowed(name: str) -> None:
    schema = types().structure(name).schema
    Draft202012Validator.check_schema(schema)
    validator = Draft202012Validator(schema)

    @given(messages(types().codec(name).shape))
    def check_one(message: Any) -> None:
        finite = "nan" not in repr(plain(message)) and "inf" not in repr(plain(message))
        if finite:
            validator.validate(json_of(message))

    check_one()


# For a grid the strategy hardly ever finds three pairs that fit.
@pytest.mark.parametrize("name", [name for name in NAMES if name != "Odd/Grid"])
def test_every_allowed_message_can_be_written(name: str) -> None:
    codec = types().codec(name)

    @given(instances(types().structure(name).schema))
    def check_one(message: Any) -> None:
        if "\\x00" in repr(message) or "\\ud" in repr(message):
            return  # a zero in a string, and half a character: JSON has them, CORBA does not
        codec.decode(codec.encode(message))

    check_one()


@pytest.mark.parametrize(("encoding", "most"), [("utf-8", 4), ("latin-1", None)])
def test_a_bound_of_a_text_counts_what_is_on_the_wire(encoding: str, most: int | None) -> None:
    schema: Any = Types([str(HERE / "types.idl")], encoding).structure("Odd/Bounded").schema
    word = schema["properties"]["word"]
    assert (word["maxLength"], word.get("x-max-utf8"), word["x-nul"]) == (4, most, False)
    verdict = check({"type": "string", "maxLength": 4}, word)
    assert verdict.compatible is (most is None)


def test_facts_are_exact() -> None:
    schema = types().structure("RTC/CameraImage").schema
    assert isinstance(schema, dict)
    assert schema["properties"]["width"] == {
        "type": "integer", "minimum": 0, "maximum": 65535, "x-native-type": "unsigned short",
    }  # fmt: skip
    assert schema["properties"]["pixels"]["x-octets"] is True
    assert schema["additionalProperties"] is False
    assert types().structure("TimedLong").native_type == "IDL:RTC/TimedLong:1.0"
    status = types().structure("ActArrayState").schema
    assert isinstance(status, dict)
    actuator = status["properties"]["actuators"]["items"]["properties"]
    assert actuator["status"]["enum"][1] == "ACTUATOR_STATUS_MOVING"
    grid = types().structure("Odd/Grid").schema
    assert isinstance(grid, dict)
    assert grid["properties"]["cells"]["minItems"] == 2
    assert grid["properties"]["cells"]["items"]["maxItems"] == 3


def test_types_are_named_and_documented_units_are_stated() -> None:
    velocity = types().structure("TimedVelocity2D").schema
    assert isinstance(velocity, dict)
    assert velocity["x-type"] == {"name": "RTC::TimedVelocity2D", "version": "1.0"}
    data = velocity["properties"]["data"]
    units = {name: member.get("x-unit") for name, member in data["properties"].items()}
    assert units == {"vx": "m/s", "vy": "m/s", "va": "rad/s"}
    stamp = velocity["properties"]["tm"]["properties"]
    assert stamp["nsec"]["x-unit"] == "ns"
    limb = types().structure("LimbState").schema
    assert isinstance(limb, dict)
    parts = limb["properties"]["oapMatrix"]["properties"]
    assert parts["approach"]["properties"]["x"]["x-unit"] == "1"
    assert parts["position"]["properties"]["x"]["x-unit"] == "m"
    plain = types().structure("TimedDouble").schema
    assert isinstance(plain, dict)
    assert "x-unit" not in plain["properties"]["data"]


def test_a_derived_type_has_no_name_of_its_own() -> None:
    structure = MessageStructure({"type": "object", "properties": {"a": {"type": "number"}},
                                  "required": ["a"], "additionalProperties": False})  # fmt: skip
    assert "x-type" not in schema_of(derive("port", structure, is_read=False))


@pytest.mark.parametrize("names", ["a_b", "A_b", "a_item"])
def test_what_is_named_alike_after_its_place_has_names_of_its_own_in_idl(names: str) -> None:
    numbers, truths = ({"type": "array", "items": {"type": k}} for k in ("number", "boolean"))
    inner = {"type": "array", "items": numbers} if names == "a_item" else of(b=numbers)
    structure = MessageStructure(of(**{"a": inner, names: truths}))
    shape = derive("port", structure, is_read=True)
    found = Types([idl_of(shape)]).structure(shape.name)
    assert check(found.schema, structure.schema).compatible
    Types().derive_interface("port", ServiceStructures(structure, structure))


def test_what_is_of_several_types_gives_none() -> None:
    structure = MessageStructure({"type": ["object", "null"], "properties": {"a": {}}})
    with pytest.raises(BridgeError, match="no type of its own"):
        derive("port", structure, is_read=False)


def test_members_of_unions_are_known_by_their_switch() -> None:
    schema = types().structure("Odd/ByNumber").schema
    assert isinstance(schema, dict)
    small, stamped, others = (case["properties"]["switch"] for case in schema["oneOf"])
    assert (small, stamped) == ({"enum": [1, 2]}, {"enum": [5]})
    assert [(gap["minimum"], gap["maximum"]) for gap in others["anyOf"]] == [
        (-32768, 0), (3, 4), (6, 32767),
    ]  # fmt: skip
    partly = types().structure("Odd/Partly").schema
    assert isinstance(partly, dict)
    assert partly["oneOf"][1]["properties"] == {"switch": {"enum": [False]}}


def test_types_are_found_beside_operations_that_take_unions() -> None:
    idl = """module Way {
      union Goal switch (boolean) { case TRUE: long number; };
      interface Guide { struct Step { long metres; }; Goal go(in Goal to, out Goal back); };
    };"""
    found = Types([idl])
    assert found.structure("Way::Goal").native_type == "IDL:Way/Goal:1.0"
    assert found.structure("Way::Guide::Step").native_type == "IDL:Way/Guide/Step:1.0"
    assert found.interface("Way::Guide::go")[1] == "go"


@pytest.mark.parametrize("name", NAMES)
def test_the_checker_understands_the_structure(name: str) -> None:
    schema = types().structure(name).schema
    assert check(schema, schema).compatible


def test_a_narrower_integer_fits_a_wider_one_only() -> None:
    short, long = (types().structure(name).schema for name in ("TimedShort", "TimedLong"))
    assert check(short, long).compatible
    assert not check(long, short).compatible


def test_user_idl_is_compiled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    load_idl("module Fresh { struct One { long a; }; };")
    folders = list((tmp_path / "uoarm" / "rtm").iterdir())
    assert len(folders) == 1
    load_idl("module Fresh { struct One { long a; }; };")
    assert list((tmp_path / "uoarm" / "rtm").iterdir()) == folders
    file = tmp_path / "mine.idl"
    (tmp_path / "part.idl").write_text("module Part { struct P { long x; }; };")
    file.write_text('#include "part.idl"\nmodule Mine { struct M { Part::P p; }; };')
    assert Types([str(file)]).codec("Mine::M").encode({"p": {"x": 1}}) == b"\1\0\0\0"
    (tmp_path / "part.idl").write_text("module Part { struct P { short x; }; };")
    assert Types([str(file)]).codec("Mine::M").encode({"p": {"x": 1}}) == b"\1\0"


def test_a_text_finds_what_it_includes_in_the_folder_of_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "idl").mkdir()
    for folder, kind in ((tmp_path, "long"), (tmp_path / "idl", "short")):
        (folder / "part.idl").write_text(f"module Part {{ struct P {{ {kind} x; }}; }};")
    idl = json.dumps('#include "part.idl"\nmodule Mine { struct M { Part::P p; }; };')
    file = tmp_path / "robot.yaml"
    text = f"version: 1\nbridges: {{rtm: {{options: {{idl: {idl}MORE}}}}}}\nfunctions: {{}}\n"
    for more, octets in (("", b"\1\0\0\0"), (", idl_folder: idl", b"\1\0")):
        file.write_text(text.replace("MORE", more))
        spec = load(file, Registry().types).bridges["rtm"]
        options = Registry().types["rtm"].value_of(spec.options, spec.folder)
        types = Types(options.idl_sources, options.text, options.idl_folder)
        assert types.codec("Mine::M").encode({"p": {"x": 1}}) == octets


@pytest.mark.parametrize("place", ["/dev/null", "~no_user_of_this_name"])
def test_idl_is_compiled_also_where_it_cannot_be_kept(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path, place: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", place)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    kind = "long" if place == "/dev/null" else "short"
    assert load_idl(f"module Unkept {{ struct One {{ {kind} a; }}; }};").scopes
    assert "compiled IDL cannot be kept: " in caplog.text
    assert "XDG_CACHE_HOME" in caplog.text
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(tempfile, "tempdir", "/dev/null")
    with pytest.raises(BridgeError, match="nor can it be written elsewhere"):
        load_idl(f"module Unkept {{ struct Two {{ {kind} a; }}; }};")


def test_compiling_waits_for_no_import_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("uoarm", "uoarm_rtm"):  # which take ten times as long as the compiler
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the compiler imports us')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    names = load_idl("module Quick { interface One { void go(in long far); }; };").names
    assert json.dumps(names) == '{"IDL:Quick/One:1.0": {"go": [["far", "in"]]}}'


def test_wrong_idl_says_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(BridgeError, match=r"the IDL text:1: Syntax error"):
        load_idl("module {")
    with pytest.raises(BridgeError, match=r"no\.idl': the file cannot be read: No such"):
        load_idl("no.idl")
    os.mkfifo(tmp_path / "pipe.idl")
    with pytest.raises(BridgeError, match="it is not a regular file"):
        load_idl(str(tmp_path / "pipe.idl"))
    assert not list((tmp_path / "uoarm" / "rtm").iterdir())


def test_the_installed_stubs_are_what_the_compiler_makes_of_the_idl(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="hatchling builds the plugin: pip install hatchling")
    spec = importlib.util.spec_from_file_location("hatch_build", HERE.parent / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    made = hook.compile_all(OUR_IDL, tmp_path)
    installed = Path(str(_uoarm_rtm_stubs.__file__)).parent
    names = {path.relative_to(made) for path in made.rglob("*.py")}
    assert names == {path.relative_to(installed) for path in installed.rglob("*.py")}
    same, differing, failed = filecmp.cmpfiles(made, installed, names, shallow=False)
    assert (len(same), differing, failed) == (len(names), [], []), "install the plugin again"


def test_missing_stubs_are_named_with_what_makes_them() -> None:
    program = (
        "import sys; sys.modules['_uoarm_rtm_stubs'] = None\n"
        "from uoarm.bridge import Registry; from uoarm.model import BridgeSpec\n"
        "Registry().create(BridgeSpec('rtm', 'rtm', {}))"
    )
    done = run_python("-c", program)
    assert "stubs of OpenRTM's IDL are missing: install uoarm-rtm again" in done.stderr


def test_paths_begin_at_the_configuration() -> None:
    located = Registry().types["rtm"].located
    text = "struct Lab { long a; };"
    for written, found in (
        ("lab.idl", "/robot/lab.idl"),
        ([text, "lab.idl"], [text, "/robot/lab.idl"]),
    ):
        assert located({"idl": written}, "/robot") == {"idl": found, "idl_folder": "/robot"}
