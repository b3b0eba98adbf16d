"""Imports go down the layers only, and importing uoarm stays light."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from bench.structure import imports_in, imports_of, long_modules, small_modules
from tests.processes import run_python

import uoarm
from uoarm.testing import patience

ROOT = Path(uoarm.__file__).parent

# From the bottom up; a layer may import itself and everything before it.
LAYERS = [
    {
        "errors",
        "_arguments",
        "_backoff",
        "_deferred",
        "_encodable",
        "_interrupts",
        "_log_lines",
        "_forks",
        "_run_as_module",
        "_version",
        "_origin",
        "_raised",
        "_secrets",
        "_spans",
        "_spelling",
        "_support",
    },
    {"error_codes"},
    {"_plugins"},
    {"plugins"},
    {"_mistakes"},
    {"schema"},
    {"model"},
    {"_figures"},
    {"_wire", "cdr"},
    {"_renewal"},
    {"_meaning"},
    {"_adapt"},
    {"_hints"},
    {"bridge"},
    {"_checks"},
    {"local"},
    {"environments"},
    {"_dataplane"},
    {"_safety"},
    {"record"},
    {"_host"},
    {"_bridges"},
    {"_parts"},
    {"config"},
    {"_resolve"},
    {"_lock"},
    {"_types"},
    {"_control"},
    {"_aio"},
    {"__init__"},
    {"testing", "_pytest_plugin"},
    {"server", "client"},
    {"cli", "__main__"},
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
# The same within a package; a package in it is imported from as a whole, unless in BY_MODULE.
BY_MODULE = {"_control"}
WITHIN = {
    "_control": [
        {"engine"},
        {"live"},
        {"candidates", "connection"},
        {"requests", "configuration_changes"},
        {"robot_view"},
        {"robot_manager"},
        {"__init__"},
    ],
    "schema": [
        {"_errors"},
        {"_values"},
        {"_verdict"},
        {"regex"},
        {"_parts"},
        {"read"},
        {"_newest"},
        {"solve"},
        {"_decide"},
        {"_check"},
        {"__init__", "__main__"},
    ],
    "server": [
        {"_limits"},
        {"access"},
        {"_failures"},
        {"streams"},
        {"session"},
        {"front_end"},
        {"publication"},
        {"http"},
        {"_options"},
        {"_server", "_service_manager"},
        {"_running"},
        {"__init__"},
    ],
}
ALONE = {
    "schema": {"schema", "_encodable"},
    "_wire": {"_wire", "model", "schema", "errors", "_raised", "_spelling"},
    "cdr": {"cdr", "model", "errors", "_deferred", "_encodable", "_raised"},
    "local": {"local", "bridge", "_hints", "model", "schema", "errors"}
    | {"_arguments", "_mistakes", "_raised", "_spelling", "_support"},
}

# Within a package: what each folder, and some modules, may import of it.
# The host's side and the manager's share the transport, and know nothing of each other.
PARTS = {
    "_host": {
        "transport": {"transport"},
        "agent": {"agent", "transport"},
        "process_connection": {"process_connection", "transport"},
        "machines": {"machines", "process_connection", "transport"},
    },
}


def _layer(path: Path) -> str:
    first = path.relative_to(ROOT).parts[0]
    return first.removesuffix(".py")


def _imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in imports_of(path):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif node.module is not None:
            names = [node.module]
            if node.module == "uoarm":
                names = [
                    f"uoarm.{alias.name}" if alias.name in RANK else "uoarm.__init__"
                    for alias in node.names
                ]
        for name in names:
            if name == "uoarm":
                found.add("__init__")
            elif name.startswith("uoarm."):
                found.add(name.split(".")[1])
    return found


MODULES = sorted(ROOT.rglob("*.py"))


def test_a_module_imports_downwards_only() -> None:
    upward = {
        str(path.relative_to(ROOT)): above
        for path in MODULES
        if (above := {name for name in _imports(path) if RANK[name] > RANK[_layer(path)]})
    }
    assert not upward, "these import what stands above them"


def test_what_stands_alone_imports_nothing_else() -> None:
    alone = [path for path in MODULES if _layer(path) in ALONE]
    assert {_layer(path) for path in alone} == ALONE.keys()
    more = {str(path.relative_to(ROOT)): _imports(path) - ALONE[_layer(path)] for path in alone}
    assert not {path: names for path, names in more.items() if names}


@pytest.mark.parametrize("whole", WITHIN)
def test_a_package_is_built_in_layers_too(whole: str) -> None:
    modules = [path for path in MODULES if _layer(path) == whole]
    assert modules
    for path in modules:
        _hold_layers_within(whole, path)


def _hold_layers_within(whole: str, path: Path) -> None:
    first = path.relative_to(ROOT).parts[1]
    layers = {name: rank for rank, names in enumerate(WITHIN[whole]) for name in names}
    layer = first.removesuffix(".py")
    for node in imports_of(path):
        module = node.module if isinstance(node, ast.ImportFrom) else None
        if module is not None and module.startswith(f"uoarm.{whole}"):
            _, _, name, *inner = [*module.split("."), "__init__"][: max(3, module.count(".") + 1)]
            assert layers[name] <= layers[layer], f"{path} imports {name}, which stands above it"
            if whole not in BY_MODULE:
                assert name == layer or not inner, f"{path} imports {module}, which is in another"


@pytest.mark.parametrize("package", PARTS)
def test_the_folders_of_a_package_import_one_way(package: str) -> None:
    inside = f"uoarm.{package}"
    allowed = PARTS[package]
    assert {path.parent.name for path in (ROOT / package).glob("*/__init__.py")} <= set(allowed)
    for part, may in allowed.items():
        paths = [*(ROOT / package).glob(f"{part}.py"), *(ROOT / package / part).glob("*.py")]
        assert paths, f"there is no {part} in {package}"
        for path in sorted(paths):
            found = {
                f"{node.module}.{alias.name}".split(".")[2]
                for node in imports_of(path)
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(inside)
                for alias in node.names
            }
            assert found <= may, f"{path.name} in {part} imports {found - may}"


# What each of these does not load: it costs every start, also of who does not need it.
FRAMEWORKS = {"rclpy", "omniORB", "hypothesis", "zenoh", "msgpack", "websockets", "paho"}
HEAVY = FRAMEWORKS | {
    "asyncio", "cattrs", "cbor2", "click", "cryptography", "cv2", "email", "http", "jsonschema",
    "numpy", "orjson", "pint", "prometheus_client", "rich", "ssl", "yaml",
}  # fmt: skip
PARTS_OF_OURS = {"cli", "client", "environments", "server", "testing", "_host", "_lock._record"}
PARTS_OF_OURS |= {"config._load", "local", "schema.read", "schema.solve", "_support.yaml._reader"}
NOT_LOADED = {
    "import uoarm": HEAVY | PARTS_OF_OURS | {"attrs", "_control", "model", "importlib.metadata"},
    "from uoarm import RobotManager": HEAVY | PARTS_OF_OURS | {"importlib.metadata"},
    "import uoarm.cdr": HEAVY | {"model", "cdr._codec"},
    "import uoarm.schema": HEAVY | {"model", "schema.read", "schema.solve"},
    "import uoarm._host.__main__": (HEAVY - {"msgpack"})
    | {"client", "config", "environments", "server", "_adapt", "_control", "_resolve", "schema"},
    "import uoarm._host.remote_bridge": {"zenoh", "cryptography", "_host.machines"},
    "import uoarm.server": FRAMEWORKS - {"websockets"}
    | {"numpy", "cv2", "pint", "record._arrivals"},
    "import uoarm.cli": (HEAVY - {"click", "email"})
    | (PARTS_OF_OURS - {"cli"})
    | {"attrs", "_control"},
    "import uoarm.cli._show": (HEAVY - {"click", "email", "yaml"})
    | {"_control", "_resolve", "_lock"},
}


@pytest.mark.parametrize("action", NOT_LOADED)
def test_what_is_not_needed_yet_is_not_loaded(action: str) -> None:
    names = {
        f"uoarm.{name}"
        if (ROOT / name.replace(".", "/")).with_suffix(".py").exists()
        or (ROOT / name.replace(".", "/")).is_dir()
        else name
        for name in NOT_LOADED[action]
    }
    gone = {name for name in names if "._" in name and not name.startswith("uoarm.")}
    assert not gone, "there are no such modules any more"
    code = f"import sys; {action}; print(*sorted({names!r} & sys.modules.keys()))"
    assert _printed(code) == ""


def test_a_robot_of_one_framework_loads_no_other_plugin_and_no_validator(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT, encoding="utf-8")
    code = f"import sys; from uoarm import RobotManager; RobotManager.from_file({str(file)!r})"
    code += "; print(*sorted(name for name in sys.modules if name.startswith('uoarm_')))"
    code += "; print('jsonschema' in sys.modules, 'asyncio' in sys.modules)"
    assert _printed(code) == "\nFalse False"


def test_a_server_with_every_front_end_loads_no_numpy(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT, encoding="utf-8")
    installed = {point.module for point in entry_points(group="uoarm.front_ends")}
    code = f"""
import sys
from uoarm import RobotManager
from uoarm.server import ServerOptions, serve_in_thread
with RobotManager.from_file({str(file)!r}) as robot, serve_in_thread(robot, ServerOptions(port=0)):
    print("numpy" in sys.modules, *{installed!r} - sys.modules.keys())
"""
    assert _printed(code) == "False"


ROBOT = """
version: 1
bridges: {python: {}}
functions:
  number:
    components: [{name: seven, bridge: python, output: {endpoint: ["builtins:int"]}}]
"""


def _printed(code: str) -> str:
    done = run_python("-c", code, check=True)
    return done.stdout.removesuffix("\n")


PLUGINS = Path(__file__).parents[1] / "plugins"


def _is_inside(parts: list[str]) -> bool:
    """Say whether a name is that of a package inside the server, which no page names."""
    inside = {path.name for path in (ROOT / "server").iterdir() if path.is_dir()}
    return len(parts) > 1 and parts[0] == "server" and parts[1] in inside


def _private(imports: Iterable[ast.Import | ast.ImportFrom]) -> set[str]:
    """Return what a module of a plugin imports of uoarm that is private."""
    found: set[str] = set()
    for node in imports:
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif node.module is not None:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            package, *parts = name.split(".")
            if package != "uoarm":
                continue
            if any(re.match("_(?!_)", part) for part in parts) or _is_inside(parts):
                found.add(name)
    return found


def test_a_plugin_imports_what_is_public_only() -> None:
    modules = sorted(PLUGINS.glob("*/src/**/*.py"))
    assert modules
    found = {
        str(path.relative_to(PLUGINS)): names
        for path in modules
        if (names := _private(imports_of(path)))
    }
    assert not found


@pytest.mark.parametrize(
    "line",
    ["import uoarm._wire", "from uoarm._wire import Form", "from uoarm.server import _feed",
     "from uoarm.server.streams._feed import Feed", "from uoarm.server.streams import Feed",
     "from uoarm.server import http", "from uoarm import __version__, _origin"],
)  # fmt: skip
def test_private_imports_are_found(line: str) -> None:
    assert _private(imports_in(line))
    theirs = line.replace("uoarm", "uoarm_ros2").replace("_origin", "errors")
    assert not _private(imports_in(theirs))


# Small modules that stay, each with why; every other one lives with its only importers.
SMALL = {
    "src/uoarm/_run_as_module.py",  # is imported for what it does, before anything else of ours
    "plugins/uoarm-rtm/src/uoarm_rtm/_back_end/uoarm_idl_names.py",  # omniidl finds it by its path
    # Every plugin has these names, also where there is little to say: who knows one knows all.
    "plugins/uoarm-rocos/src/uoarm_rocos/_discovery.py",
    "src/uoarm/cli/template/src/uoarm_example/_discovery.py",
    "src/uoarm/cli/template/src/uoarm_example/_health.py",
}


def test_a_small_module_has_three_importers_or_is_a_way_in() -> None:
    found = {str(path.relative_to(PLUGINS.parent)) for path in small_modules()}
    assert found - SMALL == set(), "join each with the module that imports it"
    assert SMALL - found == set(), "no exceptions any more: take them out"


def test_no_module_is_longer_than_one_idea() -> None:
    assert long_modules() == [], "find the two ideas in each, and give each a name"


def test_long_modules_are_found(tmp_path: Path) -> None:
    package = tmp_path / "src" / "thing"
    package.mkdir(parents=True)
    for name, lines in {"whole": 600, "double": 601}.items():
        (package / f"{name}.py").write_text("\n" * lines, encoding="utf-8")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True, timeout=patience())
    assert [path.stem for path in long_modules(tmp_path)] == ["double"]


def test_small_modules_are_found(tmp_path: Path) -> None:
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True, timeout=patience())
    package = tmp_path / "src" / "thing"
    package.mkdir(parents=True)
    sources = {
        "__init__": "from thing._public import Public",
        "_public": "from thing._inner import inner",
        "_inner": "",
        "_entry": "from thing._public import Public",
        "_large": "\n" * 80,
        "_shared": "",
        "open": "",
        **{f"_user{number}": "from thing import _shared\n" + "\n" * 80 for number in range(3)},
    }
    for name, source in sources.items():
        (package / f"{name}.py").write_text(source, encoding="utf-8")
    (tmp_path / "pyproject.toml").write_text('[project.scripts]\nrun = "thing._entry:main"\n')
    assert [path.stem for path in small_modules(tmp_path)] == ["_inner"]
