"""Where the system gives no thread, nothing is left half begun: what comes later has its thread."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.no_threads import no_threads
from tests.processes import run_python

from uoarm import RobotManager
from uoarm._control.live.listeners import EventDispatcher
from uoarm._dataplane import Route
from uoarm._renewal import renewed
from uoarm._support.workers import Timer
from uoarm.bridge import ServedRequests
from uoarm.bridge._watchdog import Watchdog
from uoarm.cli._announce import Announcement
from uoarm.config import loads
from uoarm.local._loop import LoopThread
from uoarm.model import (
    CommandPhase,
    CommandPolicy,
    ConnectionState,
    Health,
    Message,
    QueuePolicy,
    StopMessage,
)
from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import ManualClock, MemoryBridge, ResourceSnapshot, patience, wait

ROOT = Path(__file__).parents[1]
NUMBER = {"type": "integer"}
POLICY = CommandPolicy(3600.0, StopMessage(0))


def test_no_command_passes_that_no_thread_would_stop() -> None:
    taken: list[Message] = []
    watchdog = Watchdog(POLICY, taken.append, "motor")
    with no_threads():
        for _ in range(2):
            with pytest.raises(RuntimeError, match="new thread"):
                watchdog.send(5, 0.0)
    assert watchdog.status().phase is CommandPhase.IDLE
    watchdog.send(7, 0.0)
    watchdog.close()
    assert taken == [7, 0]


MOTORS = """
version: 1
bridges: {one: {plugin: memory}}
functions:
  left:
    components:
      - name: left
        bridge: one
        input: {endpoint: [left], lifetime: 3600, stop: {message: 0}, meaning: stated}
  right:
    components:
      - name: right
        bridge: one
        input: {endpoint: [right], lifetime: 3600, stop: {message: 0}, meaning: stated}
"""


def test_all_is_stopped_in_the_thread_that_asks(tmp_path: Path) -> None:
    bridge = MemoryBridge("one", {})
    bridge.taker("left", NUMBER)
    bridge.taker("right", NUMBER)
    file = tmp_path / "stop"
    with RobotManager(loads(MOTORS), bridges={"one": bridge}, stop_file=file) as robot:
        connections = [robot.request(name) for name in ("left", "right")]
        for connection in connections:
            connection.send(5)
        with no_threads():
            report = robot.stop_all(timeout=patience())
        assert file.exists()
        assert [outcome.stopped for outcome in report.inputs] == [True, True]
        robot.release()


def test_what_is_held_is_stopped() -> None:
    sent: list[Message] = []
    held = renewed(5, sent.append, lambda: sent.append(0), 3600.0)
    with no_threads(), pytest.raises(RuntimeError), held:
        pass
    assert sent == [5, 0]


def test_listeners_are_called_once_there_is_a_thread() -> None:
    dispatcher, came = EventDispatcher(ManualClock()), list[str]()
    with no_threads():
        with pytest.raises(RuntimeError):
            dispatcher.listen(lambda event: came.append("never"))
        with pytest.raises(RuntimeError):
            dispatcher.post("component a", "lost", "it was unplugged")
    dispatcher.listen(lambda event: came.append(event.subject))
    dispatcher.post("component b", "lost", "it was unplugged")
    wait(lambda: "component b" in came)
    dispatcher.close()


def test_a_timer_goes_on() -> None:
    reached = threading.Event()
    timer = Timer(ManualClock(), reached.set)
    with no_threads(), pytest.raises(RuntimeError):
        timer.wake_at(0.0)
    timer.wake_at(0.0)
    assert reached.wait(patience())
    timer.close()


def test_a_message_fails_and_the_next_one_is_handed_over() -> None:
    taken: list[Message] = []
    route = Route("a", "b", taken.append, clock=ManualClock(), queue=QueuePolicy(length=8))
    with no_threads():
        route.deliver(1)
    route.deliver(2)
    wait(lambda: taken == [2])
    route.close()
    assert route.status().dropped == (("failed", 1),)


def test_a_server_without_a_thread_leaves_nothing_open() -> None:
    with RobotManager(loads(MOTORS), bridges={"one": MemoryBridge("one", {})}) as robot:
        options, before = ServerOptions(port=0), ResourceSnapshot()
        refused = pytest.raises(RuntimeError, match="new thread")
        with no_threads("uoarm-serve"), refused, serve_in_thread(robot, options):
            pass
        before.check()
        with serve_in_thread(robot, options) as server:
            assert server.ports


def test_a_server_is_not_announced_where_there_is_no_thread(
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("zeroconf")
    with Announcement("0" * 32, ServerOptions(host="0.0.0.0")) as announcement, no_threads():
        announcement.start(9081)
    assert "not announced: can't start new thread" in capsys.readouterr().err


def test_coroutines_run_in_the_loop_that_began_later() -> None:
    async def reply() -> int:
        return 7

    loop = LoopThread("loop")
    with no_threads(), pytest.raises(RuntimeError):
        loop.submit(reply())
    assert loop.submit(reply()).result(patience()) == (7, None)
    loop.close()


def test_a_request_is_handled_with_the_next_one() -> None:
    handled: list[int] = []
    queue = ServedRequests("service", handled.append, lambda _, __: None, 1, lambda _, __: None)
    with no_threads():
        queue.put(1)
    queue.put(2)
    wait(lambda: handled == [1, 2])
    queue.close()


def test_a_bridge_that_was_lost_is_closed_at_the_end() -> None:
    bridge = MemoryBridge("one", {})
    bridge.taker("left", NUMBER)
    with RobotManager(loads(MOTORS), bridges={"one": bridge}) as robot:
        robot.request("left")
        with no_threads():
            bridge.report(Health.LOST, "it was unplugged")
    wait(lambda: bridge.closed)


PARTS = """
version: 1
bridges: {python: {}}
functions:
  one: {components: [{name: one, bridge: python, output: {endpoint: ["thread_parts:one"]}}]}
  take: {components: [{name: take, bridge: python, service: {endpoint: ["thread_parts:take"]}}]}
"""


COMMANDS = (
    "request one", "call take 1", "status", "resolve one", "lock", "types --python", "discover",
    "serve --port 0", "up --port 0", "record -o run.mcap one",
)  # fmt: skip
# Each in a process of its own, of one that has imported what all of them need.
PROGRAM = """
import os, sys
from tests.no_threads import no_threads
from uoarm.cli import main

for number, words in enumerate(sys.argv[1:]):
    if not (child := os.fork()):
        os.dup2(os.open(f"{number}.err", os.O_CREAT | os.O_WRONLY), 2)
        with no_threads():
            main(words.split())
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def test_a_command_says_that_there_is_no_thread(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(PARTS)
    (tmp_path / "thread_parts.py").write_text("def one():\n    yield 1\ndef take(value): ...\n")
    (tmp_path / "program.py").write_text(PROGRAM)
    done = run_python("program.py", *COMMANDS, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)})
    assert done.stdout.split() == ["4"] * len(COMMANDS), done.stderr
    for number, words in enumerate(COMMANDS):
        said = (tmp_path / f"{number}.err").read_text()
        assert said.endswith(
            "error: can't start new thread: a limit of this process, user or machine is reached: "
            "see ulimit -a and systemd's TasksMax\nuoarm explain UOA-001 says more\n"
        ), words
        assert "Traceback" not in said, words


def test_a_request_fails_at_once_where_only_its_own_thread_is_to_be_had(tmp_path: Path) -> None:
    """What failed to open is sought again and closed in the thread that waits for the request."""
    (tmp_path / "robot.yaml").write_text(PARTS)
    hinted = "from typing import Iterator\ndef one() -> Iterator[int]:\n    yield 1\n"
    (tmp_path / "thread_parts.py").write_text(f"{hinted}def take(value): ...\n")
    program = (
        "from tests.no_threads import no_threads\nfrom uoarm.cli import main\n"
        "with no_threads(but='uoarm-step'): main(['request', 'one', '-n', '1'])"
    )
    done = run_python("-c", program, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)})
    assert done.stderr.endswith(
        "thread_parts:one'] failed: RuntimeError: can't start new thread\n"
        "uoarm explain UOA-409 says more\n"
    )
    assert done.returncode == 4


def test_what_found_no_thread_is_done_by_who_closes() -> None:
    bridge = MemoryBridge("one", {})
    bridge.taker("left", NUMBER)
    text = f"{MOTORS}failover: {{enabled: false}}\n"
    with RobotManager(loads(text), bridges={"one": bridge}) as robot:
        connection = robot.request("left")
        with no_threads():
            bridge.report(Health.LOST, "it was unplugged")
            states = [connection.state]
            connection.close()
            assert [*states, connection.state] == [ConnectionState.CLOSING, ConnectionState.FAILED]


def test_who_closes_may_take_what_the_timer_was_about_to_start() -> None:
    class Taken(deque[Callable[[], None]]):
        """Not empty at the first look, and empty at the second one."""

        def __len__(self) -> int:
            return 1

    with RobotManager(loads("version: 1\nbridges: {}\nfunctions: {}\n")) as robot:
        driver = robot._driver
        driver._unstarted = Taken()
        driver._reach_time()
        driver._unstarted = deque()
