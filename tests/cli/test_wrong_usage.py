"""Whatever command is used wrongly says so with a code of errors, in text and in JSON."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import click
import pytest
import yaml
from click.testing import CliRunner
from tests.sweeps import for_all

from uoarm.cli import _main, main
from uoarm.cli._discover import _merge_into
from uoarm.cli._main import COMMANDS
from uoarm.error_codes import ERROR_CODES
from uoarm.testing import patience

PLUGINS = {point.name for point in entry_points(group="uoarm.commands")}


def _commands() -> Iterator[tuple[str, ...]]:
    """Yield the words of every command, those within groups too."""
    yield ()
    root = click.Context(main)
    for name in sorted(PLUGINS | {*COMMANDS}):
        yield (name,)
        command = main.get_command(root, name)
        if isinstance(command, click.Group):
            yield from ((name, member) for member in sorted(command.commands))


@for_all("words", _commands(), " ".join)
@pytest.mark.parametrize("form", [(), ("--json",)], ids=["text", "json"])
def test_an_option_that_there_is_not_has_a_code(
    words: tuple[str, ...], form: tuple[str, ...]
) -> None:
    done = CliRunner().invoke(main, [*words, "--no-such-option", *form])
    assert done.exit_code == 2, done.output
    assert done.stderr.splitlines()[-1] == "uoarm explain UOA-002 says more"
    if form:
        reply = json.loads(done.stdout)
        assert (reply["error_code"], reply["error"] != "") == ("UOA-002", True)
        assert f"error: {reply['error']}" in done.stderr
    else:
        assert done.stdout == ""


@pytest.mark.parametrize(
    "words",
    [
        ("no-such-command",),
        ("call",),
        ("call", "greeting", "{"),
        ("explain", "--json", "UOA-101", "UOA-102"),
        ("resolve", "camera", "--timeout", "soon"),
        ("token", "tablet"),
        ("status", "--url", "http://nowhere/"),
        ("--log-level", "loud", "list"),
        ("lock", "--against", "other.lock"),
        ("new-bridge", "No Name"),
        ("explain", "UOA-999"),
        ("host", "--join", "tcp/192.0.2.1:7447", "--machine", "arm"),
        *((name, "--no-such-option") for name in sorted(PLUGINS)),
    ],
    ids=" ".join,
)
def test_other_wrong_words_have_one_too(words: tuple[str, ...]) -> None:
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2, done.output
    assert done.stderr.splitlines()[-1] == "uoarm explain UOA-002 says more"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("status --bridges --watch", "give --bridges or --watch, not both"),
        ("status --all --url ws://127.0.0.1:1/", "give --all or --url, not both"),
        ("list lab.yaml --url ws://127.0.0.1:1/", "give FILE or --url, not both"),
        ("call lab.yaml arm 1 --url ws://127.0.0.1:1/", "give FILE or --url, not both"),
        ("request camera -f lab.yaml --url ws://127.0.0.1:1/", "give --file or --url, not both"),
        ("types --python --typescript", "give --python or --typescript, not both"),
        ("explain UOA-101 --markdown", "give CODE or --markdown, not both"),
        ("explain --json --markdown", "give --json or --markdown, not both"),
        ("apply lab.yaml --rollback 1", "give FILE or --rollback, not both"),
        ("list lab.yaml --token t", "without --url there is no use for --token"),
        ("status --every 5", "without --watch there is no use for --every"),
        ("discover --every 5", "without --watch there is no use for --every"),
        ("doctor lab.yaml --service", "give FILE or --service, not both"),
        ("doctor --unit robot", "without --service there is no use for --unit"),
        (f"serve --key {__file__}", "without --certificate there is no use for --key"),
        (f"serve --tls auto --certificate {__file__}", "give --tls or --certificate, not both"),
        ("lock --format json", "without --check there is no use for --format"),
        ("lock --check --against . --environment one", "give --against or --environment, not both"),
        ("check --strict", "without --recording there is no use for --strict"),
        ("host arm --xmlrpc 0 --silence 5", "without --join there is no use for --silence"),
        (
            "serve --front-end-port rosbridge=9090 --rosbridge-port 9091",
            "a front end has one further port, and is given two",
        ),
    ],
)
def test_an_option_that_would_do_nothing_beside_another_is_refused(words: str, said: str) -> None:
    done = CliRunner().invoke(main, words.split())
    assert (done.exit_code, f"error: {said}\n" in done.stderr) == (2, True), done.stderr


@pytest.mark.parametrize(
    "words",
    [
        "%s",
        "resolve %s",
        "resolve %s --json",
        "call %s",
        "check %s.yaml",
        "explain %s",
        "serve --port %s",
        "list --url %s",
        "env remove %s",
        "types --python -o %s",
        "fleet --seconds %s",
        "--log-level %s list",
    ],
)
@pytest.mark.parametrize("long", ["a" * 100_000, "a b " * 25_000], ids=["word", "words"])
def test_a_word_of_any_length_is_said_in_short(words: str, long: str, tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("version: 1\nbridges: {}\nfunctions: {}\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        done = CliRunner().invoke(main, [word.replace("%s", long) for word in words.split()])
    assert done.exit_code in {1, 2, 3, 4}, done.output
    assert max(map(len, done.output.splitlines())) < 2_500
    assert long[:100] in done.stderr


def test_the_file_of_the_variable_stands_beside_a_server() -> None:
    done = CliRunner(env={"UOARM_CONFIG": "lab.yaml"}).invoke(
        main, ["list", "--url", "ws://127.0.0.1:1/"]
    )
    assert done.exit_code == 4, done.stderr


def test_the_variable_of_the_log_has_one_too() -> None:
    done = CliRunner(env={"UOARM_LOG": "loud"}).invoke(main, ["list"])
    assert (done.exit_code, done.stderr.splitlines()[-1]) == (
        2,
        "uoarm explain UOA-002 says more",
    )


def test_an_error_is_an_object_of_json_and_help_is_none(tmp_path: Path) -> None:
    missing = CliRunner().invoke(main, ["list", str(tmp_path / "robot.yaml"), "--json"])
    assert missing.exit_code == 3
    assert json.loads(missing.stdout)["error_code"] == "UOA-101"
    shown = CliRunner().invoke(main, ["env", "--help"])
    assert (shown.exit_code, shown.stderr) == (0, "")
    assert CliRunner().invoke(main, ["explain", "002"]).stdout.startswith("UOA-002")
    assert "UOA-002" in ERROR_CODES


@pytest.mark.parametrize("seconds", ["nan", "inf", "1e300"])
@pytest.mark.parametrize(
    "words",
    [
        ("request", "camera", "--duration"),
        ("call", "greeting", "--timeout"),
        ("resolve", "camera", "--timeout"),
        ("discover", "--timeout"),
        ("status", "--every"),
        ("up", "--every"),
        ("host", "--silence"),
        ("record", "camera", "--ring"),
    ],
    ids=" ".join,
)
def test_what_no_clock_can_wait_for_is_refused(words: tuple[str, ...], seconds: str) -> None:
    done = CliRunner().invoke(main, [*words, seconds])
    assert (done.exit_code, done.stderr.splitlines()[-1]) == (2, "uoarm explain UOA-002 says more")


@pytest.mark.parametrize("url", ["ws://127.0.0.1:99999/", "ws://[::1/", "ws://robot:x/"])
def test_an_address_that_cannot_be_one_is_refused_before_anything_is_tried(url: str) -> None:
    done = CliRunner().invoke(main, ["status", "--url", url])
    assert (done.exit_code, url in done.stderr) == (2, True), done.stderr


ROBOT = """version: 1
bridges: {python: {}}
functions:
  camera: {components: [{name: odd, bridge: python, output: {endpoint: ["odd:source"]}}]}
  ask: {components: [{name: answer, bridge: python, service: {endpoint: ["odd:answer"]}}]}
"""
ODD = """from collections.abc import Iterator
from typing import TypedDict
class Number(TypedDict):
    number: int
def source() -> Iterator[Number]:
    yield {"number": 10**5000}
def answer(number: int) -> int:
    return 10**5000
"""


@pytest.fixture
def file(tmp_path: Path) -> str:
    (tmp_path / "odd.py").write_text(ODD)
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    return str(path)


@pytest.mark.parametrize("place", ["absent/robot.lock", "folder"])
def test_a_lock_that_cannot_be_written_is_said_with_the_name_that_was_given(
    place: str, file: str, tmp_path: Path
) -> None:
    (tmp_path / "folder").mkdir()
    target = tmp_path / place
    done = CliRunner().invoke(main, ["lock", "-f", file, "--lock", str(target)])
    assert done.exit_code == 3, done.output
    assert "cannot be written" in done.stderr
    assert f"error: {target}: " in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["types", "--python", "-o"], 3, "long: cannot be written: .*File name too long"),
        (["lock", "--lock"], 3, "long: cannot be written: .*File name too long"),
        (["lock", "-f"], 3, "long: the file cannot be read: File name too long"),
        (["check", "--recording"], 4, "there is no .*long$"),
        (["new-bridge", "mine", "--into"], 1, "long/uoarm-mine.*File name too long"),
        (["doctor", "--service", "--unit"], 1, "there is no unit file .*long$"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)
def test_a_name_that_no_file_can_have_is_an_error_and_no_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], code: int, said: str
) -> None:
    if "--recording" in words:
        pytest.importorskip("rosbags.highlevel", reason="pip install -e '.[bags]'")
    monkeypatch.chdir(tmp_path)
    Path("robot.yaml").write_text("version: 1\nbridges: {}\nfunctions: {}\n")
    done = CliRunner().invoke(main, [*words, f"./{'long' * 100}"])
    assert done.exit_code == code, done.output
    assert re.search(rf"^error: .*{said}", done.stderr, re.MULTILINE)


def test_a_suggestion_that_cannot_be_written_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        _merge_into(tmp_path / "absent" / "robot.yaml", "", ROBOT)
    said = capsys.readouterr().err
    assert (ended.value.code, "cannot be written" in said) == (1, True), said
    assert said.splitlines()[-1].strip() == "uoarm explain UOA-003 says more"


@pytest.mark.parametrize("words", [("request", "camera"), ("call", "ask", "1")])
def test_a_message_without_a_form_in_json_is_an_error_and_no_crash(
    words: tuple[str, ...], file: str
) -> None:
    done = CliRunner().invoke(main, [*words, "-f", file])
    assert (done.exit_code, "cannot be written as JSON" in done.stderr) == (1, True), done.output


@pytest.mark.parametrize("name", ["pad", "yes", "a, b", "# x", "a\nb", "Jörg", "12", "\U0001f916"])
def test_the_line_of_a_token_is_yaml_whatever_its_name_is(name: str) -> None:
    done = CliRunner().invoke(main, ["token", "--role", "driver: x", "--", name])
    [line] = yaml.safe_load(done.stdout)
    assert (line["name"], line["role"]) == (name, "driver: x")


@pytest.mark.parametrize(
    "words", [("", "--role", "a"), ("a", "--role", ""), ("\udcff", "--role", "a")]
)
def test_a_token_is_not_made_of_names_that_no_access_file_has(words: tuple[str, ...]) -> None:
    done = CliRunner().invoke(main, ["token", *words])
    assert (done.exit_code, "expected some text, got" in done.stderr) == (2, True), done.output
    assert done.stdout == ""


def test_a_command_of_a_plugin_that_is_not_installed_says_what_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_main, "entry_points", lambda group: [])
    done = CliRunner().invoke(main, ["fleet"])
    assert (done.exit_code, "pip install" in done.stderr) == (2, True), done.stderr
    assert "uoarm-remote" in done.stderr


OF_OURS = ("--help",), ("no-such-command", "--json"), ("list", "--no-such-option", "--json")


@pytest.mark.parametrize(
    ("unbuffered", "words"),
    [
        *((name, words) for words in OF_OURS for name in ("", "1")),
        *(("1", (name, "--help")) for name in sorted(PLUGINS)),  # whose own code writes then
    ],
    ids=lambda part: part if isinstance(part, str) else " ".join(part),
)
def test_help_for_which_there_is_no_room_is_said_as_anything_else(
    words: tuple[str, ...], unbuffered: str
) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "uoarm", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            timeout=2 * patience(),
        )
    assert (done.returncode, "nothing more can be written" in done.stderr) == (6, True)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("check", "FILE"),
        ("apply", "FILE", "--url", "ws://127.0.0.1:1"),
        ("lock", "--check", "--lock", "FILE"),
        ("types", "--python", "--lock", "FILE"),
        ("schema", "check", "FILE", "FILE"),
        ("suggest", "FILE"),
        ("suggest", "--merge", "FILE"),
        ("suggest", "other.yaml", "--merge", "FILE"),
    ],
    ids=lambda words: words[0],
)
def test_whatever_reads_a_file_says_in_the_same_words_that_it_is_not_utf8(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(b"version: 1\n# \xff\n")
    done = CliRunner().invoke(main, [str(path) if word == "FILE" else word for word in words])
    sentence = "the file is not UTF-8: byte 14 cannot be decoded (save it as UTF-8)"
    assert sentence in done.stderr, done.output
    assert done.exit_code == (2 if words[0] == "schema" else 3)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("record camera -o x.mcap --max-size huge", "'huge' is no size"),
        ("record camera -o x.mcap --split soon", "'soon' is neither a size nor a time"),
        ("record camera -o x.mcap --ring 5 --split 5MB", "leave out ring or split"),
        ("record camera camera -o x.mcap", "a function is named twice"),
        ("certificates --manager a/b --machine arm", "the manager cannot be reached at 'a/b'"),
        ("certificates --manager here --machine a/b", "a machine cannot be called 'a/b'"),
        ("env create a/b --plugin python", "'a/b' cannot be the name of an environment"),
        ("env remove a/b", "'a/b' cannot be the name of an environment"),
        ("serve robot.yaml --origin pages.example", "expected SCHEME://HOST[:PORT] or *"),
        ("serve robot.yaml --origin http://pages.example/", "expected SCHEME://HOST[:PORT] or *"),
        ("serve robot.yaml --allow-host http://robot", "expected the name of a host"),
        ("list --url wss://127.0.0.1:1/ --fingerprint 12:34", "expected SHA-256, 64 hexadecimal"),
        ("list --url ws://127.0.0.1:1/ --token \x07", "expected one line of visible characters"),
    ],
)
def test_a_value_that_cannot_be_one_is_refused_before_anything_is_done(
    words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if words.startswith("certificates"):
        pytest.importorskip("cryptography", reason="pip install -e '.[certificates]'")
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, words.split(" "))
    assert (done.exit_code, said in done.stderr) == (2, True), done.output
    assert done.stderr.splitlines()[-1] == "uoarm explain UOA-002 says more"
    assert not list(tmp_path.iterdir())


def test_the_current_folder_is_no_empty_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["new-bridge", "mine", "--into", "."])
    assert (done.exit_code, (tmp_path / "uoarm-mine").is_dir()) == (0, True), done.output


def _empty_words() -> Iterator[tuple[str, ...]]:
    """Yield the words of each command with each of its words empty that has a meaning."""
    root = click.Context(main)
    commands = [(words, main.get_command(root, words[0])) for words in _commands() if words]
    for words, group in commands:
        if words[0] not in COMMANDS:
            continue
        command = group
        if isinstance(group, click.Group) and len(words) > 1:
            command = group.get_command(root, words[1])
        assert command is not None
        for parameter in command.params:
            if isinstance(parameter, click.Option) and parameter.is_flag:
                continue
            if parameter.name in {"cause", "message"}:
                continue
            yield (
                (*words, *parameter.opts[-1:], "")
                if isinstance(parameter, click.Option)
                else (
                    *words,
                    "",
                )
            )


@for_all("words", _empty_words(), " ".join)
def test_an_empty_word_is_wrong_usage(words: tuple[str, ...]) -> None:
    done = CliRunner().invoke(main, words)
    assert (done.exit_code, done.stderr.splitlines()[-1:]) == (
        2,
        ["uoarm explain UOA-002 says more"],
    ), done.output


@pytest.mark.parametrize("words", [["check", "../robot.yaml"], ["up"], ["serve", "../robot.yaml"]])
def test_a_folder_that_was_removed_meanwhile_is_named_in_words(
    tmp_path: Path, words: list[str]
) -> None:
    (tmp_path / "robot.yaml").write_text(
        "version: 1\nbridges: {python: {}}\nfunctions: {}\n", encoding="utf-8"
    )
    (tmp_path / "gone").mkdir()
    # As the installed command is: where `-c` puts the folder itself into the path, CPython 3.13.0
    # loads no module of C any more.
    script = tmp_path / "command.py"
    script.write_text(
        f"import os; from uoarm.cli import main; os.rmdir(os.getcwd()); main({words})",
        encoding="utf-8",
    )
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path / "gone",
        capture_output=True,
        text=True,
        timeout=patience(),
        check=False,
    )
    text = "error: the folder that this runs in was removed: change to another"
    assert (done.returncode, done.stderr.splitlines()[0]) == (1, text), done.stderr
