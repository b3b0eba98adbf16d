"""The pages are true: their programs run, their commands exist, their links lead somewhere."""

from __future__ import annotations

import ast
import inspect
import json
import re
import shlex
import subprocess
import sys
import textwrap
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import jsonschema
import pytest
import yaml
from attrs import frozen
from tests.processes import run_python
from tests.sweeps import for_all

from uoarm import AsyncRobotManager, Connection, RobotManager
from uoarm.bridge import BridgeOptions, options_table
from uoarm.cli import main
from uoarm.client import RemoteRobot
from uoarm.config import published_schema
from uoarm.local import PythonOptions
from uoarm.record.plugin import PlaybackOptions
from uoarm.server.front_end import Backend, Client, Feed
from uoarm.testing import patience

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("examples/*/README.md")])
LINKING = sorted(
    {*PAGES, *ROOT.glob("*.md"), *ROOT.glob("examples/*/*.md"), *ROOT.glob("plugins/*/README.md")}
)
INSTALLING = [
    *ROOT.glob("*.md"),
    *(ROOT / "docs").glob("*.md"),
    *ROOT.glob("examples/*/README.md"),
    *ROOT.glob("plugins/*/README.md"),
]
# The commands that plugins bring, which are not installed where only the core is tested.
OF_PLUGINS = {
    name
    for project in ROOT.glob("plugins/*/pyproject.toml")
    for name in re.findall(r'"uoarm\.commands"\]\n(\w+) = ', project.read_text("utf-8"))
}


@frozen
class Block:
    """One fenced block of a page."""

    page: Path
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [
        Block(page, text[: match.start()].count("\n") + 1, match[1], match[2]) for match in found
    ]


EVERY = [block for page in PAGES for block in blocks(page)]
COMMANDS = [
    (block, line)
    for block in EVERY
    for line in block.text.splitlines()
    if re.match(r"(\.venv/bin/)?uoarm \w", line)
]


def test_the_pages_were_found() -> None:
    assert len(PAGES) > 8
    assert len(COMMANDS) > 5


@for_all("page", LINKING)
def test_links_lead_somewhere(page: Path) -> None:
    gone = []
    for target, anchor in links(page.read_text(encoding="utf-8")):
        path = page.parent / target if target else page
        if not path.exists():
            gone.append(target)
        elif anchor and path.suffix == ".md" and anchor not in anchors(path):
            gone.append(f"{target}#{anchor}")
    assert not gone


def _without_code(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def links(text: str) -> list[tuple[str, str]]:
    """Return file and anchor of each link to a place of ours."""
    prose = re.sub(r"`[^`\n]*`", "`", _without_code(text))
    found = re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", prose)
    return [link for link in found if ":" not in link[0]]


def anchors(page: Path) -> set[str]:
    """Return the anchors that the site (and GitHub) gives a page's headings."""
    text = re.sub(
        r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    headings = re.findall(r"^#{1,3} (.*)$", text, re.MULTILINE)
    found: Counter[str] = Counter()
    names = set()
    for heading in headings:
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        slug = re.sub(r"[^\w\- ]", "", shown.strip().lower()).replace(" ", "-")
        names.add(f"{slug}-{found[slug]}" if found[slug] else slug)
        found[slug] += 1
    return names


@for_all("page", PAGES)
def test_no_line_stands_twice_on_a_page(page: Path) -> None:
    lines = _without_code(page.read_text("utf-8")).splitlines()
    times = Counter(line for line in lines if len(line) > 25 and not line.startswith("|"))
    assert not [line for line, count in times.items() if count > 1]


def test_a_link_to_nothing_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# One page\n\n## `new-bridge`: a *name*\n\n## Twice\n\n## Twice\n", "utf-8")
    assert anchors(page) == {"one-page", "new-bridge-a-name", "twice", "twice-1"}
    text = "[a](other.md#b), [c](#d), [`e(f)`](g.md) and [h](https://i.example/#j) `[k](l)`"
    assert links(text) == [("other.md", "b"), ("", "d"), ("g.md", "")]


def test_every_page_is_in_the_contents() -> None:
    contents = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = {
        line
        for block in re.findall(r"^```{toctree}$(.*?)^```$", contents, re.MULTILINE | re.DOTALL)
        for line in block.splitlines()
        if line and not line.startswith(":")
    }
    every = {page.stem for page in ROOT.glob("docs/*.md")} - {"index"}
    assert listed == every
    linked = {target.removesuffix(".md") for target, _ in links(contents) if ".png" not in target}
    assert linked == every, "the page itself is read in a checkout, too"


@pytest.mark.parametrize("name", ["architecture.md", "control-plane.md"])
def test_modules_and_classes_that_the_tour_names_exist(name: str) -> None:
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    sources = {
        path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
        for pattern in ("src/**/*.py", "plugins/*/src/**/*.py", "tests/**/*.py")
        for path in ROOT.glob(pattern)
    }
    modules = set(re.findall(r"`([\w/]+\.py)`", text))
    assert not [
        item for item in modules if not any(f"/{path}".endswith(f"/{item}") for path in sources)
    ]
    defined = set(re.findall(r"^class (\w+)", "\n".join(sources.values()), re.MULTILINE))
    named = set(re.findall(r"`([A-Z][a-z]+[A-Z]\w+)`", text))
    assert named <= defined, named - defined


@frozen
class Command:
    """A command that a page shows, and what it prints."""

    line: str
    output: str


def session(text: str) -> list[Command]:
    parts = re.split(r"^\$ (.*)\n", text, flags=re.MULTILINE)[1:]
    return [Command(*pair) for pair in zip(parts[::2], parts[1::2], strict=True)]


SESSIONS = [
    block for block in EVERY if block.language == "console" and block.text.startswith("$ cat ")
]


@pytest.mark.parametrize("block", SESSIONS, ids=str)
def test_a_session_prints_what_the_page_shows(block: Block, tmp_path: Path) -> None:
    """`$ cat FILE` shows a file, which is written; each other command is run beside it."""
    for command in session(block.text):
        words = shlex.split(command.line)
        if words[0] == "cat":
            (tmp_path / words[1]).write_text(command.output, encoding="utf-8")
            continue
        program = words[1:] if words[0] == "python" else ["-m", *words]
        done = subprocess.run(
            [sys.executable, *program],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=patience(),
            check=False,
        )
        assert done.stdout == command.output


def test_pages_show_errors_as_they_are_printed() -> None:
    assert sum("uoarm explain UOA-" in block.text for block in SESSIONS) > 1


@for_all("block", [item for item in EVERY if item.language == "python"])
def test_programs_are_python(block: Block) -> None:
    compile(block.text, str(block), "exec")


def test_what_programs_import_of_ours_exists() -> None:
    imported = {
        (str(block), str(node.module), alias.name)
        for block in EVERY
        if block.language == "python"
        for node in ast.walk(ast.parse(block.text))
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "uoarm"
        for alias in node.names
    }
    assert len(imported) > 20
    missing = {place for place in imported if not hasattr(import_module(place[1]), place[2])}
    assert not missing


def test_methods_that_pages_call_exist_and_take_what_is_given() -> None:
    """A name stands for the classes whose methods pages call on it, in Python."""
    objects = {
        "robot": (RobotManager, AsyncRobotManager, RemoteRobot),
        "connection": (Connection,),
        "backend": (Backend,),
        "client": (Client,),
        "feed": (Feed,),
    }
    texts = [(block.page.name, block.text) for block in EVERY if block.language == "python"]
    for page in PAGES:
        inline = re.findall(r"`([^`\n]+)`", _without_code(page.read_text("utf-8")))
        texts.extend((page.name, text) for text in inline)
    calls = [
        (page, node, node.func.attr, objects[node.func.value.id])
        for page, text in texts
        for node in nodes(text)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and isinstance(node.func.value, ast.Name)
        and node.func.value.id in objects
    ]
    assert len(calls) > 30
    wrong = [
        f"{page}: {ast.unparse(call)}"
        for page, call, method, classes in calls
        if not any(takes(getattr(kind, method, None), call) for kind in classes)
    ]
    assert not wrong


def nodes(text: str) -> list[ast.AST]:
    try:
        return list(ast.walk(ast.parse(text)))
    except SyntaxError:
        return []


def takes(method: Any, call: ast.Call) -> bool:
    """Say whether a method can be called so; `...` among the arguments stands for any others."""
    if not callable(method):
        return False
    names = {word.arg: None for word in call.keywords if word.arg is not None}
    signature = inspect.signature(method)
    is_partial = any(getattr(item, "value", None) is ... for item in call.args)
    # The object itself comes first.
    given = [None, *(None for item in call.args if getattr(item, "value", None) is not ...)]
    try:
        (signature.bind_partial if is_partial else signature.bind)(*given, **names)
    except TypeError:
        return False
    return True


@for_all("shown", COMMANDS)
def test_commands_and_their_options_exist(shown: tuple[Block, str]) -> None:
    block, line = shown
    words = shlex.split(line, comments=True)[1:]
    command: click.Command = main
    context = click.Context(main)
    while isinstance(command, click.Group):
        name = words.pop(0)
        if command is main and name in OF_PLUGINS - {*main.list_commands(context)}:
            return  # its plugin is not installed here
        found = command.get_command(context, name)
        assert found is not None, f"{block}: no such command in {line!r}"
        command = found
    if "arguments" in {parameter.name for parameter in command.params}:
        return  # a plugin's, which reads its words itself
    known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
    given = {
        word.partition("=")[0].strip("[]") for word in words if word.strip("[").startswith("-")
    }
    assert given <= known, f"{block}: {given - known} in {line!r}"


def options(command: click.Command) -> set[str]:
    """Return the long options of a command and of those below it."""
    below = command.commands.values() if isinstance(command, click.Group) else []
    own = {option for parameter in command.params for option in parameter.opts}
    return {option for option in own if option.startswith("--")}.union(*map(options, below))


def test_every_command_and_option_is_on_a_page() -> None:
    context = click.Context(main)
    commands = {
        name: main.get_command(context, name)
        for name in main.list_commands(context)
        if name not in OF_PLUGINS
    }
    text = "".join(page.read_text("utf-8") for page in ROOT.glob("docs/*.md"))
    assert not [name for name in commands if f"`uoarm {name}" not in text]
    shown = set(re.findall(r"--[a-z][a-z-]*", text))
    for_maintainers = {"--markdown"}  # which makes the page of the error codes
    every: set[str] = set().union(*(options(command) for command in commands.values() if command))
    assert every - shown - for_maintainers == set()


@for_all("page", PAGES)
def test_commands_within_sentences_exist(page: Path) -> None:
    named = re.findall(r"`uoarm ([a-z][a-z0-9-]*)", _without_code(page.read_text("utf-8")))
    assert set(named) <= {*main.list_commands(click.Context(main)), *OF_PLUGINS}


@for_all("page", INSTALLING)
def test_what_a_page_installs_of_ours_comes_from_the_checkout(page: Path) -> None:
    """Nothing of ours is on an index yet, so that its names there are free or a stranger's."""
    for line in page.read_text(encoding="utf-8").splitlines():
        named = re.findall(r"pip install ([^`#]*)", line)
        wanted = [
            word.strip("'\"")
            for words in named
            if "--find-links" not in words
            for word in words.split()
        ]
        assert not [word for word in wanted if word.startswith("uoarm")], line


@for_all("page", [*INSTALLING, ROOT / "Makefile"])
def test_what_is_installed_of_ours_needs_nothing_else_of_ours_from_an_index(page: Path) -> None:
    """An extra of one distribution may need another, which stands in the same command then."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    for command in re.findall(r"pip install ([^`#;\n]*)", text):
        found = re.findall(
            r"(?:^|[\s'\"])(\.|(?:\./uoarm/)?plugins/[a-z\d-]+(?![\w-]))(?:\[([\w,-]+)\])?", command
        )
        wanted = {
            (Path(place).name or "uoarm", extra)
            for place, extras in found
            for extra in extras.split(",")
        }
        named = {name for name, _ in wanted}
        assert needed_of_ours(wanted) <= {"uoarm", *named}, command


def needed_of_ours(wanted: set[tuple[str, str]]) -> set[str]:
    """Return the distributions of ours that some need, each with one of its extras or with ''."""
    known, more = set[tuple[str, str]](), wanted
    while more - known:
        known |= more
        more = {needed for name, extra in known for needed in _requirements(name, extra)}
    return {name for name, _ in known}


def _requirements(name: str, extra: str) -> Iterator[tuple[str, str]]:
    tomllib = pytest.importorskip("tomllib", reason="part of Python since 3.11")
    folder = ROOT if name == "uoarm" else ROOT / "plugins" / name
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *project.get("optional-dependencies", {}).get(extra, ())]
    for line in lines:
        if match := re.match(r"(uoarm[\w-]*)(?:\[([\w,-]+)\])?", line):
            yield from ((match[1], part) for part in (match[2] or "").split(","))


def test_messages_of_the_protocol_are_as_its_schema_says() -> None:
    schema = json.loads((ROOT / "src/uoarm/_wire/protocol.schema.json").read_text("utf-8"))
    lines = [
        line
        for name in ("protocol.md", "protocol-operating.md")
        for block in blocks(ROOT / "docs" / name)
        for line in block.text.splitlines()
        if line.startswith(("→", "←"))
    ]
    assert len(lines) > 8
    for line in lines:
        message = json.loads(re.sub(r"(?:, )?…", "", line[2:]))
        side = "client" if line.startswith("→") else "server"
        jsonschema.validate(message, {**schema, "$ref": f"#/$defs/{side}.{message['op']}"})
        # As the page asks of clients.
        assert side == "server" or list(message)[-1] == "id", line


def test_configurations_and_parts_of_them_are_as_the_schema_says() -> None:
    schema = {**published_schema(), "required": []}
    parts = [
        (block, data)
        for block in EVERY
        if block.language == "yaml" and isinstance(data := yaml.safe_load(block.text), dict)
        if set(data) <= set(schema["properties"])
    ]
    assert len(parts) > 30
    validator = jsonschema.Draft202012Validator(schema)
    wrong = [
        (str(block), error.message)
        for block, data in parts
        for error in validator.iter_errors(data)
    ]
    assert not wrong


def test_every_variable_that_is_read_is_on_a_page() -> None:
    sources = [*ROOT.glob("src/**/*.py"), *ROOT.glob("plugins/*/src/**/*.py")]
    every = set[str]().union(*(variables(file) for file in (*sources, *ROOT.glob("deploy/*.py"))))
    assert len(every) > 5
    assert every <= set[str]().union(*map(variables, INSTALLING))


def variables(file: Path) -> set[str]:
    return set(re.findall(r"\bUOARM_[A-Z_]+\b", file.read_text(encoding="utf-8")))


def test_what_users_may_install_beside_is_on_a_page() -> None:
    tomllib = pytest.importorskip("tomllib", reason="part of Python since 3.11")
    text = "".join(page.read_text("utf-8") for page in INSTALLING)
    named = {extra for extras in re.findall(r"\[([\w,-]+)\]", text) for extra in extras.split(",")}
    named |= set(re.findall(r"`([\w-]+)`", text))
    not_by_hand = {"docs", "healthbot", "plots", "vision"}  # but by `make`, or as an error says
    for file in [ROOT / "pyproject.toml", *ROOT.glob("plugins/*/pyproject.toml")]:
        extras = tomllib.loads(file.read_text("utf-8"))["project"].get("optional-dependencies", {})
        assert set(extras) <= named | not_by_hand, file.parent.name


def test_the_first_steps_work_as_written(tmp_path: Path) -> None:
    install, components, robot, commands, printed, program, other, line = (
        item.text for item in blocks(ROOT / "docs" / "first-steps.md")
    )
    assert "pip install ." in install
    (tmp_path / "kitchen.py").write_text(components)
    (tmp_path / "robot.yaml").write_text(robot)
    (tmp_path / "program.py").write_text(program)
    outputs = [run(["-m", *line.split()], tmp_path) for line in commands.splitlines()]
    assert "no errors" in outputs[0]
    assert "infrared" in outputs[1]
    assert outputs[2] == printed
    assert run(["program.py"], tmp_path) == "fire! 91.5\n"
    before, _, _ = components.partition("def too_hot")
    (tmp_path / "kitchen.py").write_text(before + other)
    refused = run(["-m", "uoarm", "request", "fireAlarm"], tmp_path, code=1)
    # As the page says: with the extra of units. Without it no field is offered for the other.
    shown = textwrap.indent(line, " " * 12)
    assert shown in refused if find_spec("pint") else "map:" not in refused
    mended = robot.replace(
        "from: temperature,", f"from: temperature, {line.splitlines()[1].strip()},"
    )
    (tmp_path / "robot.yaml").write_text(mended)
    if find_spec("pint"):
        text = run(["-m", "uoarm", "request", "fireAlarm", "--count", "3"], tmp_path)
        assert [json.loads(name)["hot"] for name in text.splitlines()] == [False, False, True]


def test_a_component_works_as_written(tmp_path: Path) -> None:
    components, robot, commands, printed, program = (
        item.text for item in blocks(ROOT / "docs" / "writing-a-component.md")
    )
    (tmp_path / "parts.py").write_text(components)
    (tmp_path / "program.py").write_text(program)
    (tmp_path / "robot.yaml").write_text(robot)
    outputs = [run(["-m", *shlex.split(line)], tmp_path) for line in commands.splitlines()]
    assert "no errors" in outputs[0]
    assert outputs[1] == printed
    assert "2 m ahead" in outputs[2]
    assert run(["program.py"], tmp_path) == "2.0 2 m ahead\n1.0 1 m ahead\n"
    (tmp_path / "robot.yaml").write_text(robot.replace("near: 2.5", "neer: 2.5"))
    refused = run(["-m", "uoarm", "check", "robot.yaml"], tmp_path, code=3)
    assert "did you mean 'near'" in refused


def run(arguments: list[str], folder: Path, code: int = 0) -> str:
    done = run_python(*arguments, cwd=folder)
    assert done.returncode == code, done.stderr
    return done.stdout if code == 0 else done.stderr


@pytest.mark.parametrize(
    ("page", "kind"), [("configuration.md", PythonOptions), ("recordings.md", PlaybackOptions)]
)
def test_the_page_of_a_bridge_of_the_core_has_its_options(
    page: str, kind: type[BridgeOptions]
) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert options_table(kind.schema()) in text
