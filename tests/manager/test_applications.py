"""A manager in applications that end, or thread, or loop as they want."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from tests.processes import run_python

from uoarm.testing import patience

PARTS = """
import threading
from collections.abc import Iterator

def ticks() -> Iterator[int]:
    yield 1
    threading.Event().wait()

def add(value: int) -> int:
    return value + 1

def hang(value: int) -> int:
    print("asked", flush=True)
    threading.Event().wait()

async def outside(value: int) -> int:
    import asyncio
    return await asyncio.to_thread(add, value)
"""
ROBOT = """
version: 1
bridges: {near: {plugin: python, options: {path: ["."]}}}
functions:
  ticks: {components: [{name: ticks, bridge: near, output: {endpoint: ["parts:ticks"]}}]}
  add: {components: [{name: add, bridge: near, service: {endpoint: ["parts:add"]}}]}
  hang: {components: [{name: hang, bridge: near, service: {endpoint: ["parts:hang"]}}]}
  outside: {components: [{name: outside, bridge: near, service: {endpoint: ["parts:outside"]}}]}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return tmp_path


def run(folder: Path, program: str) -> list[str]:
    """Run a program that gets the limit of a test, and return the lines that it prints."""
    (folder / "program.py").write_text(program)
    done = run_python("program.py", str(patience()), cwd=folder)
    assert (done.stderr, done.returncode) == ("", 0)
    return done.stdout.splitlines()


OUTLIVES = """
import asyncio, sys, threading
from concurrent.futures import thread as executors
from uoarm import AsyncRobotManager
from uoarm.server import ServerOptions, serve_in_thread

limit, main = float(sys.argv[1]), threading.main_thread()

async def work():
    async with AsyncRobotManager.from_file("robot.yaml") as manager:
        async with await manager.request("ticks") as ticks:
            print(await ticks.get(limit))
            main.join()
            while not executors._shutdown:  # what the end of the main thread does to these
                await asyncio.sleep(0.01)
            print(await manager.call("add", 1, timeout=limit))
            print(await manager.call("outside", 2, timeout=limit))
        print(len(await manager.check_availability()))
        await manager.stop_all(timeout=limit)
        print(manager.is_stopped)
        await manager.release(timeout=limit)
        with serve_in_thread(manager.robot, ServerOptions(host="localhost", port=0)) as server:
            print(len(server.ports))
    print("closed")

threading.Thread(target=lambda: asyncio.run(work())).start()
"""


@pytest.mark.skipif(
    (3, 12) <= sys.version_info < (3, 12, 3),
    reason="these start no thread once the main thread has ended (python/cpython#113964)",
)
def test_a_thread_goes_on_with_all_when_the_main_thread_has_ended(folder: Path) -> None:
    assert run(folder, OUTLIVES) == ["1", "2", "3", "4", "True", "1", "closed"]


LEAVES = """
import asyncio, os, signal, sys, threading
from uoarm import AsyncRobotManager

def interrupt():
    os.read(asked, 1)
    os.kill(os.getpid(), signal.SIGINT)

asked, written = os.pipe()
os.dup2(written, 1)  # the component writes when it was asked

async def work():
    async with AsyncRobotManager.from_file("robot.yaml") as manager:
        await manager.call("hang", 1, timeout=1000 * float(sys.argv[1]))

threading.Thread(target=interrupt).start()
try:
    asyncio.run(work())
except KeyboardInterrupt:
    sys.exit(7)
"""


def test_an_interrupt_ends_a_process_in_which_a_call_hangs(folder: Path) -> None:
    (folder / "program.py").write_text(LEAVES)
    done = run_python("program.py", str(patience()), cwd=folder)
    assert (done.stderr, done.returncode) == ("", 7)


SERVES = """
import os, signal, socket, threading
from uoarm import RobotManager
from uoarm.server import ServerOptions, run

def end(server):
    threading.Thread(target=os.kill, args=(os.getpid(), signal.SIGTERM)).start()

def own(number, frame):
    print("own", number == signal.SIGTERM)

near, far = socket.socketpair()
near.setblocking(False)
signal.set_wakeup_fd(near.fileno())
signal.signal(signal.SIGTERM, own)
signal.signal(signal.SIGINT, signal.SIG_IGN)
with RobotManager.from_file("robot.yaml") as robot:
    run(robot, ServerOptions(port=0), ready=end)
    print("served")
    signal.raise_signal(signal.SIGTERM)
    signal.raise_signal(signal.SIGINT)
    print(far.recv(9) == bytes([signal.SIGTERM]))
"""


def test_signals_are_an_applications_own_again_when_it_has_served(folder: Path) -> None:
    assert run(folder, SERVES) == ["served", "own True", "True"]
