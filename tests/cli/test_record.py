"""`uoarm record`: files that are whole however it is ended, and what was lost."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.processes import SIGNALS_AS_IT_OPENS, run_python
from tests.record.conftest import of_topic

from uoarm import RobotManager
from uoarm.cli import main
from uoarm.config import loads
from uoarm.errors import ConfigurationError, UsageError
from uoarm.testing import patience

PARTS = """
import itertools
import time
from collections.abc import Iterator


def few() -> Iterator[int]:
    yield from range(5)


def none() -> Iterator[int]:
    yield from ()


def wrong() -> Iterator[int]:
    yield object()


def dies() -> Iterator[int]:
    yield 1
    raise OSError("the cable is out")


def many() -> Iterator[int]:
    for number in itertools.count():
        yield number
        time.sleep(0.001)
"""
ROBOT = """
version: 1
bridges: {python: {}}
functions:
  few: {components: [{name: few, bridge: python, output: {endpoint: ["parts:few"]}}]}
  none: {components: [{name: none, bridge: python, output: {endpoint: ["parts:none"]}}]}
  wrong: {components: [{name: wrong, bridge: python, output: {endpoint: ["parts:wrong"]}}]}
  dies: {components: [{name: dies, bridge: python, output: {endpoint: ["parts:dies"]}}]}
  many: {components: [{name: many, bridge: python, output: {endpoint: ["parts:many"]}}]}
"""


def make(folder: Path, more: str = "") -> Path:
    (folder / "parts.py").write_text(PARTS)
    (folder / "robot.yaml").write_text(ROBOT + more)
    return folder / "robot.yaml"


def numbers(path: Path, topic: str) -> list[int]:
    return [json.loads(message.data) for message in of_topic(path, topic)]


def test_it_ends_with_its_functions_and_says_what_was_recorded(tmp_path: Path) -> None:
    words = ["record", "few", str(make(tmp_path)), "-o", str(tmp_path / "run.mcap"), "--json"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    status = json.loads(done.stdout.splitlines()[-1])
    assert (status["state"], status["channels"][0]["recorded"]) == ("ended", 5)
    assert numbers(tmp_path / "run.mcap", "/few") == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("functions", "code", "says"),
    [
        (["none", "few"], 0, ""),
        (["none"], 4, "nothing was recorded"),
        (["none", "wrong"], 4, "nothing was recorded"),
        (["few", "dies"], 4, "dies: .*the cable is out"),
    ],
    ids=str,
)
def test_functions_that_fail_or_give_nothing_fail_it(
    tmp_path: Path, functions: list[str], code: int, says: str
) -> None:
    words = ["record", "-f", str(make(tmp_path)), *functions, "-o", str(tmp_path / "run.mcap")]
    done = CliRunner().invoke(main, [*words, "--json"])
    assert done.exit_code == code, done.output
    assert re.search(says, done.stderr)
    status = json.loads(done.stdout.splitlines()[-1])
    assert status["state"] == "ended"
    assert all(
        "cable" in item["failure"] or item["function"] != "dies" for item in status["channels"]
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_and_the_file_is_whole(tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "run.mcap"
    code = "from uoarm.cli import main; main()"
    words = ["record", "-f", str(make(tmp_path)), "many", "-o", str(path), "--json"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        while json.loads(process.stdout.readline())["channels"][0]["recorded"] < 10:
            pass
        process.send_signal(number)
        last = process.stdout.read().splitlines()[-1]
        assert process.wait(patience()) == 0
    status = json.loads(last)
    assert status["state"] == "ended"
    assert numbers(path, "/many") == list(range(status["channels"][0]["recorded"]))


def test_it_ends_after_its_time(tmp_path: Path) -> None:
    words = ["record", "many", str(make(tmp_path)), "-o", str(tmp_path / "run.mcap")]
    done = CliRunner().invoke(main, [*words, "--duration", "1"])
    assert done.exit_code == 0, done.output
    assert "many: " in done.stdout
    assert " messages as json" in done.stdout
    assert "lost" not in done.stdout


def test_it_splits_compresses_and_ends_after_its_size(tmp_path: Path) -> None:
    words = ["record", "many", str(make(tmp_path)), "-o", str(tmp_path / "run.mcap"), "--json"]
    more = ["--split", "8kB", "--max-size", "20kB", "--compress", "lz4"]
    done = CliRunner().invoke(main, [*words, *more])
    assert done.exit_code == 0, done.output
    status = json.loads(done.stdout.splitlines()[-1])
    assert status["cause"] == "its files have 20,000 octets"
    assert len(status["files"]) > 1
    found = [number for file in status["files"] for number in numbers(Path(file), "/many")]
    assert found == list(range(len(found)))
    assert b"lz4" in Path(status["files"][0]).read_bytes()


@pytest.mark.skipif(not hasattr(signal, "SIGUSR1"), reason="this system has no such signal")
def test_a_ring_is_written_at_a_signal(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    code = "from uoarm.cli import main; main()"
    words = ["record", "-f", str(make(tmp_path)), "many", "-o", str(path), "--json", "--ring", "60"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        while json.loads(process.stdout.readline())["channels"][0]["recorded"] < 10:
            assert not path.exists()
        process.send_signal(signal.SIGUSR1)
        while not json.loads(process.stdout.readline())["files"]:
            pass
        process.send_signal(signal.SIGTERM)
        process.stdout.read()
        assert process.wait(patience()) == 0
    assert numbers(path, "/many")[:10] == list(range(10))


@pytest.mark.skipif(not hasattr(signal, "SIGUSR1"), reason="this system has no such signal")
def test_the_signal_ends_nothing_that_opens_still(tmp_path: Path) -> None:
    file = make(tmp_path)
    file.write_text(ROBOT.replace("parts:few", "early:Early"))
    (tmp_path / "early.py").write_text(SIGNALS_AS_IT_OPENS)
    path = str(tmp_path / "run.mcap")
    words = ["record", "-f", str(file), "few", "-o", path, "--ring", "60"]
    done = run_python("-c", "from uoarm.cli import main; main()", *words)
    assert done.returncode == 0, done.stderr


def test_without_a_name_it_is_what_the_configuration_says(tmp_path: Path) -> None:
    more = "record: {functions: [few], path: kept.mcap, compression: none}\n"
    done = CliRunner().invoke(main, ["record", str(make(tmp_path, more))])
    assert done.exit_code == 0, done.output
    assert numbers(tmp_path / "kept.mcap", "/few") == [0, 1, 2, 3, 4]


def test_what_it_lacks_is_named(tmp_path: Path) -> None:
    file = str(make(tmp_path))
    done = CliRunner().invoke(main, ["record", file, "-o", "x.mcap"])
    assert (done.exit_code, "has the functions few, none" in done.output) == (2, True)
    done = CliRunner().invoke(main, ["record", file, "few"])
    assert (done.exit_code, "say into which file" in done.output) == (2, True)
    done = CliRunner().invoke(main, ["record", file, "few", "-o", "-"])
    assert (done.exit_code, "a recording is no stream" in done.output) == (2, True)
    with pytest.raises(UsageError, match="say into which file"):
        RobotManager(loads(ROBOT)).record("few")


def test_a_function_that_is_not_there_is_a_mistake_of_the_configuration() -> None:
    with pytest.raises(ConfigurationError, match='there is no function "fex"') as caught:
        loads(ROBOT + "record: {functions: [fex, many.debug], path: x.mcap}\n")
    assert "did you mean" in str(caught.value)


@pytest.mark.parametrize(
    ("line", "mistake"),
    [
        ("functions: [many.debug]", 'functions[0]: no component of "many" has an output "debug"'),
        ("functions: [many], max_size: zz", "max_size: 'zz' is no size"),
        ("functions: [many], max_size: 0", "max_size: 0 is no size"),
        ("functions: [many], split: often", "split: 'often' is neither a size nor a time"),
        ("functions: [many], split: 1s, ring: 5", "split: a ring has a file for each time"),
        ("functions: [many], ring: 1e12", "ring: "),
    ],
)
def test_options_that_mean_nothing_are_mistakes_of_the_configuration(
    line: str, mistake: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        loads(f"{ROBOT}record: {{{line}, path: x.mcap}}\n")
    assert f"$.record.{mistake}" in str(caught.value)


@pytest.mark.parametrize("package", ["numpy", "mcap"])
def test_without_the_extra_the_command_says_what_installs_it(tmp_path: Path, package: str) -> None:
    """numpy, too: what reads it as it is imported must not be imported first."""
    (tmp_path / "robot.yaml").write_text("{version: 1, bridges: {python: {}}, functions: {}}")
    lacking = f"import sys; sys.modules[{package!r}] = None; from uoarm.cli import main; "
    done = run_python("-c", f"{lacking}main(['record', 'a', '-o', 'run.mcap'])", cwd=tmp_path)
    assert (done.returncode, "recordings need: pip install" in done.stderr) == (4, True), done
    done = run_python("-c", f"{lacking}main(['doctor', '--json'])", cwd=tmp_path)
    assert "recordings need: pip install" in json.loads(done.stdout)["recording"]["usable"]
