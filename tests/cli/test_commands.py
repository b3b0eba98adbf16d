"""The command line: what it prints, as text and as JSON, and how it exits."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner, Result
from tests.processes import run_program, run_python

from uoarm import Connection
from uoarm.bridge import Registry, install_command
from uoarm.cli import _run, main
from uoarm.config import completed_schema
from uoarm.environments import environment_python
from uoarm.testing import ManualClock, wait

pytestmark = pytest.mark.keeps("descriptor of pipe")  # doctor: of ROS 2, for signals
ROBOT = """
version: 1
bridges: {python: {}}
functions:
  count:
    components:
      - {name: counter, bridge: python, output: {endpoint: ["cli_counting:count"]}}
  doubled:
    components:
      - name: doubler
        bridge: python
        input: {from: count, endpoint: ["cli_counting:double"], queue: {policy: block, timeout: 30}}
        output: {endpoint: ["cli_counting:double"]}
  greeting:
    components:
      - {name: greeter, bridge: python, service: {endpoint: ["cli_counting:greet"]}}
  divided:
    components:
      - {name: divider, bridge: python, service: {endpoint: ["cli_counting:divide"]}}
  kept:
    components:
      - name: keeper
        bridge: python
        input: {from: count, endpoint: ["cli_counting:keep"], queue: {policy: block, timeout: 30}}
  broken:
    components:
      - name: breaker
        bridge: python
        input: {from: dying, endpoint: ["cli_counting:keep"]}
  dying:
    components:
      - {name: dying, bridge: python, output: {endpoint: ["cli_counting:die"]}}
  ticks:
    components:
      - {name: ticker, bridge: python, output: {endpoint: ["cli_counting:ticks"]}}
  wrong:
    components:
      - name: mistaken
        bridge: python
        input:
          from: count
          endpoint: ["cli_counting:mistaken"]
          queue: {policy: block, timeout: 30}
        output: {endpoint: ["cli_counting:mistaken"]}
  endless:
    components:
      - name: forever
        bridge: python
        input: {from: ticks, endpoint: ["cli_counting:mistaken"]}
        output: {endpoint: ["cli_counting:mistaken"]}
  failing:
    components:
      - name: thrower
        bridge: python
        input: {from: ticks, endpoint: ["cli_counting:refuse"]}
        output: {endpoint: ["cli_counting:refuse"]}
  failed:
    components:
      - name: short
        bridge: python
        input: {from: count, endpoint: ["cli_counting:refuse"]}
        output: {endpoint: ["cli_counting:refuse"]}
  misfit:
    components:
      - name: misfit
        bridge: python
        input: {from: count, endpoint: ["cli_counting:shout"]}
  once:
    components: [{name: once, bridge: python, output: {endpoint: ["cli_counting:Once"]}}]
"""
COMPONENTS = """
import time
from collections.abc import Iterator
from typing import TypedDict
class Number(TypedDict):
    n: int
class Text(TypedDict):
    text: str
class Numbers(TypedDict):
    n: list[float]
class Nothing(TypedDict):
    pass
def divide(message: Nothing) -> Numbers:
    return {"n": [float("nan"), float("-inf")]}
def count() -> Iterator[Number]:
    for n in range(4):
        yield {"n": n}
def ticks() -> Iterator[Number]:
    while True:
        yield {"n": 1}
        time.sleep(0.01)
def refuse(m: Number) -> Number:
    raise OSError("the sensor is gone")
def double(m: Number) -> Number:
    return {"n": m["n"] * 2}
def mistaken(m: Number) -> Number:
    return {"n": "one"}
def greet(m: Number) -> Text:
    return {"text": f"hello {m['n']}"}
def keep(m: Number) -> None:
    pass
def die() -> Iterator[Number]:
    yield {"n": 1}
    raise RuntimeError("the source is worn out")
def shout(m: Text) -> None:
    pass
class Once:
    is_gone = False
    def __init__(self) -> None:
        if Once.is_gone:
            raise OSError("there is none")
    def __iter__(self) -> Iterator[Number]:
        Once.is_gone = True
        raise OSError("it was unplugged")
        yield {"n": 1}
"""


@pytest.fixture
def robot(tmp_path: Path) -> str:
    (tmp_path / "cli_counting.py").write_text(COMPONENTS)
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT)
    return str(file)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, list(arguments))


def test_check_counts_what_is_there(robot: str) -> None:
    result = run("check", robot)
    assert result.exit_code == 0
    assert "no errors (functions: 14, bridges: 1)" in result.output


def test_check_exits_with_three_and_says_where(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("version: 1\nbridges: {}\nfunctions: {a: {components: []}}\n")
    result = run("check", str(file), "--json")
    assert result.exit_code == 3
    (problem,) = json.loads(result.stdout)["problems"]
    assert problem["path"] == "$.functions.a.components"


def test_resolve_explains(robot: str) -> None:
    assert run("resolve", "doubled", "-f", robot).output == "counter -> doubler\n"
    assert (
        "counter.default -> doubler.default"
        in run("resolve", "doubled", "-f", robot, "--explain").output
    )
    plan = json.loads(run("resolve", "doubled", "-f", robot, "--json").stdout)
    assert [step["component"]["name"] for step in plan["steps"]] == ["counter", "doubler"]


def test_resolve_shows_where_a_function_is_offered(robot: str) -> None:
    with Path(robot).open("a") as file:
        file.write("offer: {python: {count: {output: {endpoint: ['cli_counting:keep']}}}}\n")
    result = run("resolve", "count", "-f", robot, "--explain").output
    assert result.endswith("offered in python at cli_counting:keep\n")
    plan = json.loads(run("resolve", "count", "-f", robot, "--json").stdout)
    assert plan["offers"] == [{"bridge": "python", "endpoints": [["cli_counting:keep"]]}]


def test_a_refusal_exits_with_one_and_shows_the_counterexample(robot: str) -> None:
    result = run("resolve", "misfit", "-f", robot)
    assert result.exit_code == 1
    assert "required" in result.output
    assert "'text'" in result.output


def test_a_refusal_is_data_too(robot: str) -> None:
    result = run("resolve", "misfit", "-f", robot, "--json")
    assert result.exit_code == 1
    result = json.loads(result.stdout)
    assert result["function"] == "misfit"
    assert "misfit" in result["error"]
    assert [rejection["component"] for rejection in result["rejected"]] == ["misfit"]


def test_request_ends_with_the_cause_when_what_it_waits_for_raises(robot: str) -> None:
    result = run("request", "failing", "-n", "1", "-f", robot)
    assert result.exit_code == 4
    assert result.stdout == ""
    assert "error: component 'thrower' was lost: its input 'default' raises" in result.stderr
    assert "OSError: the sensor is gone" in result.stderr


def test_request_says_once_why_it_ends(tmp_path: Path, robot: str) -> None:
    """In a process of its own: the records of a death are written by another thread."""
    done = run_python("-m", "uoarm", "request", "failing", "-n", "1", "-f", robot, cwd=tmp_path)
    lines = done.stderr.splitlines()
    assert [line for line in lines if "again and again" in line] == [
        line for line in lines if line.startswith("error: ")
    ]
    assert sum("raised OSError: the sensor is gone" in line for line in lines) == 1
    assert done.returncode == 4


def test_request_says_what_it_waits_for(robot: str) -> None:
    Path(robot).write_text(ROBOT + "failover: {wait: 3600}\n")
    command = [sys.executable, "-m", "uoarm", "request", "once", "-f", robot]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            first = next(line for line in process.stderr if line.startswith(("warning", "error")))
            process.send_signal(signal.SIGINT)
            rest = process.stderr.read()
        finally:
            process.kill()
    assert "it waits: component 'once' was lost: its source raised OSError: it was un" in first
    assert "warning: " not in rest


def test_request_ends_with_the_cause_when_too_few_came_since_a_component_raised(robot: str) -> None:
    result = run("request", "failed", "-n", "1", "-f", robot)
    assert result.exit_code == 4
    sentence = "it ended after 0 of 1 messages: short.default raised OSError: the sensor is gone"
    assert sentence in result.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-n", "5"], "it ended after 0 of 5 messages"),
        ([], "it ended after 0 messages"),
        (["--validate", "always", "--json"], "it ended after 0 messages"),
    ],
)
def test_request_ends_with_the_cause_when_no_message_matched(
    robot: str, arguments: list[str], said: str
) -> None:
    result = run("request", "wrong", "-f", robot, *arguments)
    codes = [json.loads(line)["error_code"] for line in result.stdout.splitlines()]
    assert (result.exit_code, codes) == (4, ["UOA-805"] if "--json" in arguments else [])
    assert f"error: {said}: mistaken.default gave 4 that do not match" in result.stderr
    assert "expected a whole number" in result.stderr


def test_request_ends_with_the_cause_when_the_time_is_up_and_no_message_matched(
    robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path(robot).write_text(ROBOT + "failover: {failing: {messages: 1000000}}\n")
    clock, get = ManualClock(), Connection.get

    def get_late(connection: Connection, timeout: float) -> object:
        """Have the time be up once a message came that does not match, and not before."""
        wait(lambda: any(route.invalid for route in connection.routes()))
        clock.advance(5.0)
        return get(connection, timeout)

    monkeypatch.setattr(_run, "time", SimpleNamespace(monotonic=clock))
    monkeypatch.setattr(Connection, "get", get_late)
    result = run("request", "endless", "--duration", "5", "-f", robot)
    assert result.exit_code == 4
    assert "that do not match" in result.stderr


def test_request_prints_a_message_a_line(robot: str) -> None:
    result = run("request", "doubled", "-f", robot)
    assert [json.loads(line)["n"] for line in result.output.splitlines()] == [0, 2, 4, 6]
    assert result.exit_code == 0


def test_request_warns_of_what_a_careful_reader_should_know(robot: str) -> None:
    text = Path(robot).read_text(encoding="utf-8")
    declared = '["cli_counting:count"], structure: {type: object}}'
    Path(robot).write_text(text.replace('["cli_counting:count"]}', declared), encoding="utf-8")
    result = run("request", "count", "-f", robot, "-n", "1")
    assert "warning: counter.output.default: the declared structure replaces" in result.stderr
    assert result.exit_code == 0


def test_a_function_without_an_output_runs_until_it_ends(robot: str) -> None:
    result = run("request", "kept", "-f", robot)
    assert (result.exit_code, result.stdout) == (0, ""), result.output
    assert "no output to show" in result.stderr


def test_a_function_without_an_output_that_dies_says_why(robot: str) -> None:
    result = run("request", "broken", "-f", robot)
    assert result.exit_code == 4
    assert "the source is worn out" in result.stderr


def test_a_service_is_called_and_not_requested(robot: str) -> None:
    result = run("request", "-f", robot, "greeting", "--duration", "0")
    assert result.exit_code == 1
    assert "function 'greeting' is a service: use call, not request" in result.stderr


def test_request_ends_after_so_many(robot: str) -> None:
    assert len(run("request", "doubled", "-f", robot, "-n", "2").output.splitlines()) == 2


def test_call_prints_the_reply(robot: str) -> None:
    assert json.loads(run("call", "greeting", '{"n": 3}', "-f", robot).stdout) == {
        "text": "hello 3"
    }
    assert run("call", "greeting", '{"n": "x"}', "-f", robot).exit_code == 1
    assert run("call", "greeting", "{", "-f", robot).exit_code == 2


@pytest.mark.parametrize("number", ["1e400", "NaN", "-Infinity", '1, "n": 2'])
def test_an_argument_that_readers_of_json_disagree_on_is_refused(robot: str, number: str) -> None:
    result = run("call", "greeting", f'{{"n": {number}}}', "-f", robot)
    assert result.exit_code == 2
    assert "not JSON: " in result.stderr


def test_what_is_not_finite_is_printed_as_json(robot: str) -> None:
    result = run("call", "divided", "{}", "-f", robot)
    assert json.loads(result.stdout, parse_constant=pytest.fail) == {"n": ["NaN", "-Infinity"]}


def test_octets_are_printed_in_full_as_a_call_takes_them(tmp_path: Path) -> None:
    (tmp_path / "cli_octets.py").write_text(
        "from uoarm.local import Octets\ndef echo(p: Octets) -> Octets: return bytes(p)\n"
    )
    file = tmp_path / "robot.yaml"
    file.write_text(
        "{version: 1, bridges: {python: {}}, functions: {echo: {components: ["
        '{name: echo, bridge: python, service: {endpoint: ["cli_octets:echo"]}}]}}}'
    )
    assert json.loads(run("call", "echo", "[0, 255]", "-f", str(file)).stdout) == [0, 255]


def test_doctor_and_bridges_know_the_built_in_bridge() -> None:
    assert "python" in run("bridges").output
    assert json.loads(run("doctor", "--json").stdout)["python"]["usable"] == "yes"


def test_the_doctor_says_that_a_plugin_without_its_middleware_is_not_usable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("uoarm_ros2")
    monkeypatch.setitem(sys.modules, "rclpy", None)
    for name in [module for module in sys.modules if module.startswith("uoarm_ros2._middleware")]:
        monkeypatch.delitem(sys.modules, name)
    found = json.loads(run("doctor", "--json").stdout)["ros2"]
    assert found["usable"].startswith("no: rclpy cannot be imported: install it with pip install")
    assert "rclpy" not in found


def test_the_doctor_asks_the_environments_of_a_configuration(tmp_path: Path) -> None:
    pytest.importorskip("uoarm._host")
    there = tmp_path / "bin" / "python"
    there.parent.mkdir()
    result = {"uoarm": {"version": "9.9"}, "python": {"usable": "yes", "library": "old 1.2"}}
    there.write_text(f"#!/bin/sh\necho \"$@\" >&2\necho '{json.dumps(result)}'\n")
    there.chmod(0o755)
    file = tmp_path / "robot.yaml"
    file.write_text(
        f"version: 1\nbridges:\n  far: {{plugin: python, host: {{python: {there}}}}}\n"
        f"  gone: {{plugin: python, host: {{python: {tmp_path / 'none'}}}}}\n"
        "  near: {plugin: python}\nfunctions: {}\n"
    )
    found = json.loads(run("doctor", "-f", str(file), "--json").stdout)
    assert found[f"far, with {there}"] == {"uoarm": "9.9", "usable": "yes", "library": "old 1.2"}
    assert found[f"gone, with {tmp_path / 'none'}"]["usable"].startswith("no: there is no Python")
    assert not [name for name in found if name.startswith("near")]


@pytest.mark.parametrize(
    ("host", "cause"),
    [("python: PYTHON", "it has no uoarm that answers"),
     ('python: PYTHON, variables: {A: "b\\0"}', "embedded null byte")],
)  # fmt: skip
def test_the_doctor_says_what_a_python_that_cannot_be_asked_does(
    tmp_path: Path, host: str, cause: str
) -> None:
    pytest.importorskip("uoarm._host")
    there = tmp_path / "python"
    there.write_text("#!/bin/sh\nprintf '\\377'\n")
    there.chmod(0o755)
    file = tmp_path / "robot.yaml"
    host = host.replace("PYTHON", str(there))
    file.write_text(f"version: 1\nbridges: {{python: {{host: {{{host}}}}}}}\nfunctions: {{}}\n")
    found = json.loads(run("doctor", str(file), "--json").stdout)
    assert cause in found[f"python, with {there}"]["usable"]


@pytest.mark.parametrize(("consumer", "code"), [({"type": "integer"}, 0), ({"type": "string"}, 1)])
def test_schema_check_exits_by_its_verdict(tmp_path: Path, consumer: object, code: int) -> None:
    (tmp_path / "a.json").write_text('{"type": "integer", "minimum": 0}')
    (tmp_path / "b.json").write_text(json.dumps(consumer))
    result = run("schema", "check", str(tmp_path / "a.json"), str(tmp_path / "b.json"), "--json")
    assert result.exit_code == code
    assert json.loads(result.stdout)["compatible"] is (code == 0)


@pytest.mark.parametrize("text", ["{", '{"type": 1}', None], ids=["no JSON", "none", "absent"])
def test_schema_check_says_as_json_what_is_wrong(tmp_path: Path, text: str | None) -> None:
    (tmp_path / "a.json").write_text('{"type": "integer"}')
    other = tmp_path / "b.json"
    if text is not None:
        other.write_text(text)
    result = run("schema", "check", str(tmp_path / "a.json"), str(other), "--json")
    assert result.exit_code == 2
    reply = json.loads(result.stdout)
    assert reply["error"] in result.stderr
    assert re.fullmatch(r"UOA-\d+", reply["error_code"])


def test_schema_check_reads_no_device_to_an_end_that_there_is_not() -> None:
    result = run("schema", "check", "/dev/zero", "/dev/zero")
    assert result.exit_code == 2
    assert "/dev/zero: the file cannot be read: it has more than 64,000,000" in result.output


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"type": "integer", "type": "string"}', 'the key "type" is given twice'),
        ('{"properties": {"a": {}, "a": false}}', 'the key "a" is given twice'),
        ('{"maximum": 1e400}', "1e400 is beyond what a number of 64 bits can hold"),
        ('{"maximum": NaN}', "NaN is no number of JSON"),
        (r'{"const": "\ud800"}', "surrogates not allowed"),
        ("[" * 100_000, "not JSON"),
        ("{", "not JSON"),
    ],
)
def test_schema_check_refuses_what_has_two_readings_or_none(
    tmp_path: Path, text: str, said: str
) -> None:
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(text)
    result = run("schema", "check", str(tmp_path / "a.json"), str(tmp_path / "b.json"))
    assert result.exit_code == 2
    assert said in result.output


def test_a_message_nested_too_deeply_is_a_bad_parameter(robot: str) -> None:
    result = run("call", "greeting", "[" * 100_000, "-f", robot)
    assert result.exit_code == 2
    assert "not JSON" in result.output


def test_without_descriptors_a_command_says_so_in_one_line(robot: str) -> None:
    """Of half an event loop asyncio would say more."""
    for limit in (6, 8, 10):
        words = ["-m", "uoarm", "list", "--url", "ws://127.0.0.1:1/"]
        done = run_program("prlimit", f"--nofile={limit}:{limit}", sys.executable, *words)
        first, last = done.stderr.splitlines()
        assert (first.partition(": a limit")[0], done.returncode) == (
            "error: Too many open files",
            4,
        )
        assert last == "uoarm explain UOA-001 says more"


def test_watching_ends_with_an_interrupt_and_no_error(
    robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("uoarm.cli._discover.time", SimpleNamespace(sleep=interrupt))
    assert run("status", "-f", robot, "--watch").exit_code == 0


def test_status_says_what_can_be_had_and_what_cannot(robot: str) -> None:
    result = run("status", "-f", robot)
    assert result.exit_code == 1
    assert "doubled  from doubler" in result.output
    assert "misfit  unavailable" in result.output
    shown = json.loads(run("status", "-f", robot, "--json").stdout)
    functions = {function["name"]: function for function in shown}
    assert functions["count"]["provider"] == "counter"
    assert functions["count"]["candidates"][0]["cause"] == ""
    assert functions["misfit"]["provider"] is None


@pytest.mark.parametrize(
    ("module", "extra", "command"),
    [
        ("uoarm._support.certificates", "certificates", ["certificates", "--machine", "arm"]),
        ("uoarm.client", "server", ["status", "--url", "ws://127.0.0.1:1/"]),
        ("uoarm._host", "machines", ["host", "--join", "tcp/127.0.0.1:1", "--machine", "arm"]),
        ("uoarm.server", "server", ["token", "pad", "--role", "driver"]),
    ],
)
def test_a_command_whose_extra_is_not_installed_says_which(
    monkeypatch: pytest.MonkeyPatch, module: str, extra: str, command: list[str]
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    result = run(*command)
    assert result.exit_code == 4
    assert install_command("uoarm", extra) in result.stderr


def test_check_warns_of_what_the_file_names_and_is_not_here(tmp_path: Path) -> None:
    (tmp_path / "kitchen.py").write_text("def stove(on: bool) -> int:\n    return 1\n")
    (tmp_path / "licensed.py").write_text("raise RuntimeError('the licence has ended')\n")
    (tmp_path / "robot.yaml").write_text("""\
version: 1
bridges: {python: {}, away: {plugin: absent}, there: {plugin: absent, host: {environment: x}}}
functions:
  heat:
    components:
      - {name: here, bridge: python, priority: 6, service: {endpoint: ["kitchen:stove"]}}
      - {name: mistyped, bridge: python, priority: 5, service: {endpoint: ["kitchn:stove"]}}
      - {name: misnamed, bridge: python, priority: 4, service: {endpoint: ["kitchen:stve"]}}
      - {name: raising, bridge: python, priority: 3, service: {endpoint: ["licensed:stove"]}}
      - {name: far, bridge: away, priority: 2, service: {endpoint: [a]}}
      - {name: farther, bridge: there, priority: 1, service: {endpoint: [a]}}
""")
    python = environment_python("x")
    done = CliRunner().invoke(main, ["check", str(tmp_path / "robot.yaml"), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["problems"] == []
    at = {
        (warning["place"]["line"], warning["sentence"].partition(":")[0])
        for warning in result["warnings"]
    }
    bridges = {(2, "it was not checked"), (2, f"there is no Python interpreter at {python}")}
    assert at == bridges | {(n, "it is unavailable here") for n in (7, 8, 9)}
    texts = " ".join(warning["sentence"] for warning in result["warnings"])
    assert "no module 'kitchn'" in texts
    assert "did you mean 'stove'" in texts
    assert "RuntimeError: the licence has ended" in texts
    assert "there is no plugin 'absent'" in texts


def test_schema_prints_that_of_the_configuration() -> None:
    done = run("schema")
    assert (done.exit_code, json.loads(done.stdout)) == (0, completed_schema(Registry().types)), (
        done.output
    )
    assert run("schema", "check", "--help").exit_code == 0


@pytest.mark.parametrize("command", ["request", "call", "resolve"])
@pytest.mark.parametrize("way", ["as a word", "with -f", "in the folder"])
def test_where_the_function_is_missing_those_of_the_file_are_named(
    robot: str, command: str, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(Path(robot).parent)
    given = {"as a word": [robot], "with -f": ["-f", robot], "in the folder": []}[way]
    done = run(command, *given)
    assert done.exit_code == 2
    said = " ".join(done.stderr.split())
    assert "Missing argument 'NAME'." in said
    functions = said.partition("has the functions ")[2]
    assert ("greeting" in functions) is (command != "request")
    assert ("doubled" in functions) is (command != "call")


def test_where_the_file_is_missing_too_that_is_said(tmp_path: Path) -> None:
    done = run("request", str(tmp_path / "none.yaml"))
    assert done.exit_code == 2
    assert "none.yaml: the file cannot be read" in " ".join(done.stderr.split())


def test_of_very_many_functions_some_are_named(robot: str) -> None:
    many = "".join(
        f"  f{number}:\n    components: [{{name: c{number}, bridge: python, "
        f'service: {{endpoint: ["cli_counting:greet"]}}}}]\n'
        for number in range(50)
    )
    Path(robot).write_text(f"version: 1\nbridges: {{python: {{}}}}\nfunctions:\n{many}")
    assert "f18, f19 and 30 more\n" in run("call", robot).stderr
