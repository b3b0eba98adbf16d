"""A generated bridge passes the conformance kit as it is, every section of it."""

from __future__ import annotations

import runpy
import socket
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.processes import run_python

import uoarm.cli
from uoarm.cli import main
from uoarm.testing import patience

TEMPLATE = Path(uoarm.cli.__file__).parent / "template"


def make(name: str, into: Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["new-bridge", name, "--into", str(into)])
    return result.exit_code, result.output


def install(project: Path, name: str) -> None:
    """Have the plugin found by its entry point, as pip would, in hosts too."""
    found = project / "src" / f"uoarm_{name}-0.1.0.dist-info"
    found.mkdir()
    metadata = f"Metadata-Version: 2.1\nName: uoarm-{name}\nVersion: 0.1.0\n"
    (found / "METADATA").write_text(metadata, encoding="utf-8")
    entry = f"[uoarm.bridges]\n{name} = uoarm_{name}\n"
    (found / "entry_points.txt").write_text(entry, encoding="utf-8")


# Each test starts a host: of each section the one that asks most of what is between the two, with
# the type that has a structure.
HOSTED = (
    "the_options_reach",
    "describing_twice",
    "discovered_components",
    "every_message_of_the_structure",
    "recorded_samples",
    "retained_message",
    "a_call_returns",
    "silent_ends_in_time",
    "answers_until_it_is_closed",
    "carries_messages_without",
    "closing_while_messages_flow",
    "messages_pass_again",
    "a_death_is_reported",
    "cannot_be_read",
)


@pytest.mark.parametrize(
    "tests",
    [
        f"TestMyBusBridge or (TestInAHost and not text and ({' or '.join(HOSTED)}))",
        pytest.param("TestInAHost", marks=pytest.mark.long),
    ],
    ids=["here and in a host", "in a host, the whole suite"],
)
def test_the_generated_bridge_passes_the_kit(tests: str, tmp_path: Path) -> None:
    code, text = make("my_bus", tmp_path)
    assert code == 0
    assert "pytest" in text
    project = tmp_path / "uoarm-my-bus"
    install(project, "my_bus")
    words = ["-m", "pytest", "-v", "-rs", "-p", "no:cacheprovider", "-k", tests]
    done = run_python(*words, cwd=project, env={"PYTHONPATH": str(project / "src")})
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout
    if HOSTED[0] in tests:
        assert "::TestMyBusBridge::" in done.stdout
        assert done.stdout.count("::TestInAHost::") == len(HOSTED)
    assert "skipped" not in done.stdout, "every section of the kit has something to do"


def test_the_bus_of_the_tests_ends_with_a_client_that_broke_off_within_a_line() -> None:
    """Such a client has ended for its bus; `close` waited for it without an end."""
    bus = runpy.run_path(str(TEMPLATE / "tests" / "bus.py"))["ExampleBus"]({}, {})
    with socket.create_connection(("127.0.0.1", bus.port), patience()) as client:
        assert client.recv(1) == b"\n"
        client.sendall(b'{"do": "publish", "topic": "te')
        client.shutdown(socket.SHUT_WR)
        assert client.recv(1) == b"", "the bus closes what has ended"
    bus.close()


def test_the_name_stands_where_the_template_says_example_and_nowhere_else(tmp_path: Path) -> None:
    """Also a name that has the word in it, and beside `examples`, which JSON Schema knows."""
    name = "my_example_bus"
    assert make(name, tmp_path)[0] == 0
    project = tmp_path / "uoarm-my-example-bus"
    assert 'name = "uoarm-my-example-bus"' in (project / "pyproject.toml").read_text()
    code = "from uoarm_my_example_bus._options import BusOptions; print(BusOptions.schema())"
    done = run_python("-B", "-c", code, env={"PYTHONPATH": str(project / "src")}, check=True)
    assert "'examples': [7400]" in done.stdout
    texts = [path.read_text() for path in project.rglob("*") if path.is_file()]
    assert "my_my_example" not in "".join(texts)
    assert make("bus", tmp_path)[0] == 0
    texts = [path.read_text() for path in (tmp_path / "uoarm-bus").rglob("*") if path.is_file()]
    assert "example" not in "".join(texts).lower().replace('"examples"', "")


def test_a_name_that_no_distribution_may_have_or_that_is_taken_is_refused(tmp_path: Path) -> None:
    for name in ("a_", "a__b", "_a", "a" * 41):
        code, text = make(name, tmp_path)
        assert code == 2, name
        assert "small letters" in text
    code, text = make("python", tmp_path)
    assert code == 2
    assert "a plugin 'python' is installed already" in text
    assert not list(tmp_path.iterdir())


def test_a_bad_name_and_a_folder_that_is_there_are_refused(tmp_path: Path) -> None:
    code, text = make("My-Bus", tmp_path)
    assert code == 2
    assert "small letters" in text
    (tmp_path / "uoarm-bus").mkdir()
    code, text = make("bus", tmp_path)
    assert code == 1
    assert "is there already" in text
    assert not list((tmp_path / "uoarm-bus").iterdir())
