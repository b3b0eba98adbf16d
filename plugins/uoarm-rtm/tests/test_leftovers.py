"""What we connect is ours to end: whatever way a process of ours goes, nothing of it stays."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from endpoints import ANSWERS, HANGS_AFTER, Make, Start, endpoint, source
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm._journal import Journal, JournalEntry, journal

from uoarm.bridge import Bridge
from uoarm.model import Role
from uoarm.testing import patience, wait

HERE = Path(__file__).parent

OPENS = """
import os, signal, sys
sys.path.insert(0, {here!r})
from endpoints import ANSWERS, endpoint, sink, source
from tests.inbox import Inbox
from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Role
from uoarm.testing import patience
options = {{"nameserver": {nameserver!r}, "call_timeout": ANSWERS}}
bridge = Registry().create(BridgeSpec("rtm", "rtm", options))
at = lambda role, name, port: endpoint(role, f"{{name}}.rtc", port)
out, into = at(Role.OUTPUT, "From", "out"), at(Role.INPUT, "Into", "in")
linked = bridge.link(out, into, timeout=patience())
channels = [linked, source(bridge, out, Inbox()), sink(bridge, into)]
print("open", flush=True)
if sys.stdin.readline() == "fork\\n":
    pid = os.fork()
    if pid == 0:
        linked.close()
        bridge.close()
        sys.exit(3)
    print("child", os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
    sys.stdin.read()
"""


@contextmanager
def holding(nameserver: str) -> Iterator[subprocess.Popen[str]]:
    """Run a process with a native link, an output and an input between From and Into."""
    script = OPENS.format(here=str(HERE), nameserver=nameserver)
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "open\n"
            yield process
        finally:
            process.kill()


def test_a_child_that_is_forked_ends_nothing_of_its_parent(
    nameserver: str, peer: Start, state: Path
) -> None:
    """Neither our connectors, nor the journal of them, by which the next process would end them."""
    ends = peer("From"), peer("Into")
    with holding(nameserver) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        before = [end.connectors() for end in ends]
        process.stdin.write("fork\n")
        process.stdin.flush()
        assert process.stdout.readline() == "child 3\n"
        assert [end.connectors() for end in ends] == before
        assert list(state.glob("*/*.json"))


def test_a_connector_says_who_made_it(bridge: Bridge, peer: Start) -> None:
    component = peer("From")
    source(bridge, endpoint(Role.OUTPUT, "From.rtc", "out"), Inbox())
    [made] = component.made()
    assert made["uoarm.name"] == "uoarm_rtm"
    host, process, token = made["uoarm.process"].split("/")
    assert (host, process, token) == (socket.gethostname(), str(os.getpid()), journal().token)


def test_what_a_killed_process_left_is_ended_by_the_next_and_nothing_else(
    nameserver: str, make_bridge: Make, peer: Start, state: Path
) -> None:
    first, second = peer("From"), peer("Into")
    properties = {"dataport.interface_type": "corba_cdr", "dataport.dataflow_type": "push"}
    first.connect(nameserver, "Into.rtc", "in", properties)
    with holding(nameserver) as living, holding(nameserver) as killed:
        assert (first.connectors(), second.connectors()) == ([0, 5], [5, 0])
        killed.kill()
        killed.wait()
        source(make_bridge(), endpoint(Role.OUTPUT, "From.rtc", "out"), Inbox())
        assert (first.connectors(), second.connectors()) == ([0, 4], [3, 0])
        kept = {item.get("uoarm.process", "").split("/")[-1] for item in first.made()}
        names = {path.name for path in state.iterdir()}
        assert kept - {""} <= names
        living.kill()
        living.wait()
    source(make_bridge(), endpoint(Role.OUTPUT, "From.rtc", "out"), Inbox())
    assert (first.connectors(), second.connectors()) == ([0, 3], [1, 0])


def test_one_end_may_have_died_with_us(nameserver: str, make_bridge: Make, peer: Start) -> None:
    first, second = peer("From"), peer("Into")
    with holding(nameserver) as killed:
        killed.kill()
        killed.wait()
    first.kill()
    other = peer("Other")
    source(make_bridge(), endpoint(Role.OUTPUT, "Other.rtc", "out"), Inbox())
    assert second.connectors() == [0, 0]
    assert other.connectors() == [0, 1]


def test_what_hangs_is_left_to_the_process_after_the_next(
    nameserver: str, make_bridge: Make, peer: Start
) -> None:
    first, second = peer("From"), peer("Into")
    with holding(nameserver) as killed:
        killed.kill()
        killed.wait()
    second.freeze()
    peer("Other")
    other = endpoint(Role.OUTPUT, "Other.rtc", "out")
    source(make_bridge(call_timeout=HANGS_AFTER), other, Inbox())
    second.thaw()
    wait(lambda: first.connectors()[1] == 0)
    source(make_bridge(), other, Inbox())
    wait(lambda: second.connectors() == [0, 0])


@pytest.mark.parametrize("ending", ["falls off its end", "is interrupted"])
def test_a_process_that_closes_nothing_leaves_nothing(
    nameserver: str, peer: Start, ending: str
) -> None:
    first, second = peer("From"), peer("Into")
    with holding(nameserver) as process:
        if ending == "is interrupted":
            process.send_signal(signal.SIGINT)
        assert process.stdin is not None
        process.stdin.close()
        process.wait(patience())
        assert (first.connectors(), second.connectors()) == ([0, 0], [0, 0])


def test_a_command_that_is_terminated_leaves_nothing(
    nameserver: str, peer: Start, tmp_path: Path
) -> None:
    component = peer("From")
    file = tmp_path / "robot.yaml"
    file.write_text(f"""
version: 1
bridges:
  rtm: {{plugin: rtm, options: {{nameserver: "{nameserver}", call_timeout: {ANSWERS}}}}}
functions:
  numbers:
    components:
      - {{name: from, bridge: rtm, output: {{endpoint: [From.rtc, out]}}}}
""")
    command = [sys.executable, "-m", "uoarm", "request", "numbers", "-f", str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        wait(lambda: component.connectors() == [0, 1])
        component.write({"tm": {"sec": 1, "nsec": 0}, "data": 1})
        assert process.stdout is not None
        assert process.stdout.readline()
        process.terminate()
        assert process.wait(patience()) == 128 + signal.SIGTERM
    assert component.connectors() == [0, 0]


def test_a_journal_knows_which_processes_are_dead(tmp_path: Path) -> None:
    ours, other = Journal(tmp_path), Journal(tmp_path)
    assert ours.runs(ours.token)
    assert ours.runs(other.token) is None
    script = f"""
import sys
from pathlib import Path
from uoarm_rtm._journal import Journal, JournalEntry
journal = Journal(Path({str(tmp_path)!r}))
journal.write(JournalEntry("one", ("IOR:1",), "there"))
journal.write(JournalEntry("two", ("IOR:2",), "here"))
journal.erase("one")
print(journal.token, flush=True)
sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        token = process.stdout.readline().strip()
        assert ours.runs(token)
        assert list(ours.left()) == []
        process.kill()
        process.wait()
    assert ours.runs(token) is False
    assert list(ours.left()) == [(token, [JournalEntry("two", ("IOR:2",), "here")])]
    (tmp_path / token / "garbage.json").write_text('{"ports": 1')
    assert list(ours.left()) == [(token, [JournalEntry("two", ("IOR:2",), "here")])]
    ours.erase("two", token)
    assert list(ours.left()) == [(token, [])]
    assert list(ours.left()) == []
    assert not (tmp_path / token).exists()


def test_a_journal_that_cannot_be_written_is_said_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "uoarm").write_text("in the way")
    broken = Journal(tmp_path / "uoarm")
    broken.write(JournalEntry("one", (), "there"))
    broken.write(JournalEntry("two", (), "there"))
    assert len(caplog.records) == 1
    assert "a kill would leave them behind" in caplog.text
    broken.close()
