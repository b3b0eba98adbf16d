"""Types from a lock: checkers accept them, messages fit them, and no schema is too strange."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.processes import run_program, run_python
from tests.structures import closed

import uoarm
from uoarm._hints.schemas import schema_of
from uoarm._lock import Lock, read_lock, write_lock
from uoarm._lock._record import LockedFunction, LockedPart, LockedStructure
from uoarm._types import read_functions, write_document, write_python, write_typescript
from uoarm.cli import main
from uoarm.schema import check

EXAMPLES = Path(__file__).parents[2] / "examples"
NUMBER = {"type": "number"}
OCTETS = {
    "type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}, "x-octets": True,
}  # fmt: skip


TREE = {"$defs": {"node": closed(name={"type": "string"}, more={
    "type": "array", "items": {"$ref": "#/$defs/node"}})}, "$ref": "#/$defs/node"}  # fmt: skip
STRANGE = {
    **closed(**{
        "frame-id": {"type": ["string", "null"]},
        "class": {"enum": ["a", 1, True, None, "é\n\u2028\"'\\"]},
        "list": {"type": "array", "items": NUMBER, "minItems": 3, "maxItems": 3},
        "__own": OCTETS,
    }),
    "required": ["frame-id", "elsewhere"],
    "additionalProperties": NUMBER,
}  # fmt: skip
SCAN = closed(
    list=NUMBER,  # would hide the type from those after it
    ranges={"type": "array", "items": NUMBER},
    mode={"enum": ["near", "far"]},
    pose=closed(x=NUMBER, y=NUMBER),
    stamp={"type": "integer"},
    count={"type": "integer", "minimum": 0, "maximum": 9},
    pair={"type": "array", "prefixItems": [{"type": "string"}, {"type": "boolean"}],
          "items": False, "minItems": 2},
    table={"type": "object", "additionalProperties": {"type": "string"}},
    pattern={"type": "object", "patternProperties": {"^a": NUMBER}},
    either={"anyOf": [{"type": "string"}, closed(z=NUMBER)]},
    image=OCTETS,
    anything={"not": {"type": "string"}},
)  # fmt: skip


def lock_of(**functions: dict[str, Any]) -> Lock:
    """Return a lock of functions with these structures by their ports."""
    structures = {
        f"{name}/{port}": LockedStructure("", schema)
        for name, ports in functions.items()
        for port, schema in ports.items()
    }
    locked = {
        name: LockedFunction(
            (LockedPart(name, name, "b", "python", {port: f"{name}/{port}" for port in ports}),)
        )
        for name, ports in functions.items()
    }
    return Lock(locked, structures)


def usual() -> Lock:
    return lock_of(
        scan={"output.default": SCAN},
        camera={"output.left": STRANGE, "output.right": {"type": "number"}, "input.go": SCAN},
        tree={"output.default": TREE},
        add={"request": closed(a=NUMBER, b=NUMBER), "reply": NUMBER},
    )


USE = """
from uoarm import RobotManager
from made import CameraOutputLeft, ScanOutput, TreeOutput, typed

def use(manager: RobotManager) -> None:
    robot = typed(manager)
    scan: ScanOutput = next(iter(robot.request("scan")))
    near: bool = scan["mode"] == "near"
    x: float = scan["pose"]["x"]
    total: float = robot.call("add", {"a": 1, "b": 2.5})
    plain = manager.request("scan", as_type=ScanOutput)
    again: ScanOutput = next(iter(plain))
    tree: TreeOutput = {"name": "a", "more": [{"name": "b", "more": []}]}
    robot.call("add", {"a": 1})  # type: ignore[typeddict-item]
    robot.call("scan", {"a": 1, "b": 2})  # type: ignore[arg-type]
    robot.request("scam")  # type: ignore[call-overload]
    scan["mood"]  # type: ignore[typeddict-item]
    wrong: TreeOutput = {"name": "a", "more": [1]}  # type: ignore[list-item]
    strange: CameraOutputLeft = {"frame-id": None, "elsewhere": 1, "list": [1, 2.5], "class": 1}
"""


def mypy(folder: Path, *files: str) -> None:
    cache = ("--cache-dir", EXAMPLES.parent / ".mypy_cache" / "types")
    options = ("--strict", "--config-file", os.devnull, *cache)
    done = run_python("-m", "mypy", *options, *files, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.long
def test_mypy_accepts_the_module_what_fits_it_and_nothing_else(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    (tmp_path / "made.py").write_text(write_python(read_functions(usual())), encoding="utf-8")
    (tmp_path / "use.py").write_text(USE, encoding="utf-8")
    vision = write_python(read_functions(_vision(tmp_path)))
    (tmp_path / "vision.py").write_text(vision, encoding="utf-8")
    (tmp_path / "none.py").write_text(write_python(read_functions(Lock({}, {}))), encoding="utf-8")
    mypy(tmp_path, "made.py", "use.py", "vision.py", "none.py")


def _vision(folder: Path) -> Lock:
    path = folder / "vision.lock"
    run_python("-m", "uoarm", "lock", "--lock", path, cwd=EXAMPLES / "vision", check=True)
    return read_lock(path)


@pytest.mark.long
def test_tsc_accepts_the_declarations(tmp_path: Path) -> None:
    tsc = shutil.which("tsc")
    if tsc is None:
        pytest.skip("no tsc: npm install -g typescript")
    static = Path(uoarm.__file__).parent / "server" / "static"
    shutil.copy(static / "uoarm.d.ts", tmp_path)
    for name, lock in (("made", usual()), ("none", Lock({}, {}))):
        text = write_typescript(read_functions(lock))
        (tmp_path / f"{name}.d.ts").write_text(text, encoding="utf-8")
    (tmp_path / "use.ts").write_text(USE_TS, encoding="utf-8")
    options = ["--strict", "--noEmit", "--target", "es2022", "--module", "es2022",
               "--moduleResolution", "bundler"]  # fmt: skip
    done = run_program(tsc, *options, "use.ts", "none.d.ts", cwd=tmp_path)
    assert done.returncode == 0, done.stdout


USE_TS = """
import { connect } from "./uoarm.js";
import type { CameraOutputLeft, ScanOutput, TypedRobot } from "./made";
const robot = (await connect("ws://localhost")) as TypedRobot;
const stream = await robot.request("scan");
for await (const scan of stream) {
  const x: number = Number(scan.pose.x);
  if (typeof scan.stamp === "string") BigInt(scan.stamp);
  const mode: "near" | "far" = scan.mode;
  const pair: [string, boolean] = scan.pair;
}
const total = Number(await robot.call("add", { a: 1, b: 2 }));
const left: CameraOutputLeft = { "frame-id": null, elsewhere: 1, more: 1, class: 1 };
// @ts-expect-error
await robot.request("scam");
// @ts-expect-error
await robot.call("add", { a: 1 });
// @ts-expect-error
const wrong: ScanOutput = {};
"""


def test_a_wide_integer_may_be_its_digits_in_typescript() -> None:
    wide = closed(at={"type": "integer"}, ratio=NUMBER)
    text = write_typescript(read_functions(lock_of(scan={"output.default": wide})))
    assert '"at": Integer;' in text
    for kind in ("Integer = number | bigint | `${bigint}`;", "Real = Integer |"):
        assert f"export type {kind}" in text, "as JSON.parse gives what the protocol writes"


def test_a_structure_without_any_is_proven_to_be_its_type(monkeypatch: pytest.MonkeyPatch) -> None:
    """`as_type` takes what is written: every message of the structure is one."""
    members = SCAN["properties"].items()
    schema = closed(**{key: item for key, item in members if key not in {"pattern", "anything"}})
    made = ModuleType("made")
    monkeypatch.setitem(sys.modules, "made", made)
    source = write_python(read_functions(lock_of(scan={"output.default": schema})))
    exec(source, made.__dict__)
    verdict = check(schema, schema_of(made.ScanOutput))
    assert verdict.compatible, verdict.reasons


def run(folder: Path, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["types", "-f", str(folder / "robot.yaml"), *arguments])


def test_the_command_says_its_source_and_writes_whole_files(tmp_path: Path) -> None:
    (tmp_path / "robot.lock").write_text(write_lock(usual()), encoding="utf-8")
    done = run(tmp_path, "--python")
    assert (done.exit_code, "robot.yaml: the file cannot be read" in done.stderr) == (3, True)
    (tmp_path / "robot.yaml").write_text("version: 1")
    for form in ("--python", "--typescript", "--jsonschema"):
        done = run(tmp_path, form, "-o", str(tmp_path / "made"))
        assert done.exit_code == 0, done.output
        assert "robot.lock" in done.stderr
        assert run(tmp_path, form).stdout == (tmp_path / "made").read_text(encoding="utf-8")
    assert run(tmp_path).exit_code == 2
    assert run(tmp_path, "--python", "--lock", str(tmp_path / "no.lock")).exit_code == 3
    assert run(tmp_path, "--python", "-o", str(tmp_path / "no" / "made")).exit_code == 3
    (tmp_path / "robot.lock").write_text(
        write_lock(Lock({"arm": LockedFunction(refused="nothing fits")}, {})), encoding="utf-8"
    )
    done = run(tmp_path, "--python")
    assert (done.exit_code, "arm has no plan" in done.stderr) == (1, True)


def test_without_a_lock_the_configuration_is_asked(tmp_path: Path) -> None:
    (tmp_path / "desk.py").write_text("def add(both: dict[str, float]) -> float:\n    return 1.0\n")
    (tmp_path / "robot.yaml").write_text(
        "version: 1\nbridges: {python: {}}\nfunctions:\n  add:\n    components:\n"
        '      - {name: add, bridge: python, service: {endpoint: ["desk:add"]}}\n'
    )
    done = run(tmp_path, "--typescript")
    assert done.exit_code == 0, done.output
    assert "bridges" in done.stderr
    assert '"add": AddReply;' in done.stdout


def test_one_schema_holds_each_structure_as_it_was() -> None:
    document = json.loads(write_document(read_functions(usual())))
    assert document["x-functions"]["add"]["reply"] == {"$ref": "#/$defs/AddReply"}
    tree = document["$defs"].pop("TreeOutput")
    assert tree.pop("$id") == "urn:uoarm:TreeOutput"
    assert tree == TREE
    whole = {**document, "$defs": {"TreeOutput": {**tree, "$id": "urn:t"}},
             "$ref": "#/$defs/TreeOutput"}  # fmt: skip
    assert check(whole, TREE).compatible
    assert check(TREE, whole).compatible


KEYS = (
    st.sampled_from(["a", "a-b", "class", "__x", "list", "é", "", "\n", "Any", "None"]) | st.text()
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)
KINDS = st.sampled_from(["null", "boolean", "integer", "number", "string", "array", "object"])


def _record(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    members = st.dictionaries(KEYS, inner, min_size=1, max_size=3)
    return st.builds(lambda values: closed(**values), members)


def _schema(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    several = st.lists(inner, max_size=3)
    members = st.dictionaries(KEYS, inner, max_size=3)
    return st.fixed_dictionaries({}, optional={
        "type": KINDS | st.lists(KINDS, max_size=3) | JSON,
        "properties": members | JSON,
        "required": st.lists(KEYS, max_size=3) | JSON,
        "additionalProperties": inner,
        "patternProperties": members | JSON,
        "items": inner, "prefixItems": several | JSON,
        "minItems": st.integers(0, 3) | JSON, "maxItems": st.integers(0, 3) | JSON,
        "enum": st.lists(JSON, max_size=4) | JSON, "const": JSON,
        "anyOf": several | JSON, "oneOf": several, "allOf": several,
        "$ref": st.sampled_from(["#", "#/properties/a", "#/$defs/b", "#/items", "#c", "x#"]) | JSON,
        "$defs": members, "$id": st.text(), "x-octets": st.booleans(),
        "minimum": st.floats() | JSON, "maximum": st.integers() | JSON,
    })  # fmt: skip


LEAVES = st.booleans() | JSON
SCHEMAS = st.recursive(LEAVES, lambda inner: _schema(inner) | _record(inner), max_leaves=4)


@settings(max_examples=12, deadline=None)
@given(st.dictionaries(KEYS, st.tuples(_record(SCHEMAS), SCHEMAS), min_size=1, max_size=2))
def test_no_schema_is_too_strange(functions: dict[str, tuple[Any, Any]]) -> None:
    lock = lock_of(**{
        name: {"output.default": item, "output.other-one": two, "request": two, "reply": item}
        for name, (item, two) in functions.items()
    })  # fmt: skip
    read = read_functions(lock)
    source = write_python(read)
    made: dict[str, Any] = {"__name__": __name__}
    exec(compile(source, "made.py", "exec"), made)
    assert source.isascii()
    assert source == write_python(read_functions(lock))
    assert write_typescript(read).isascii()
    json.loads(write_document(read))
