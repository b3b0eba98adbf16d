"""Handlers whose cost grows with the robot, asked by many clients at once: the loop stays free.

What a client waits for is the longest step of the loop, in CPU time: that hardly depends on what
else the machine does, and the limit is thirty times what a step takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from urllib.request import urlopen

import pytest
from tests.server.robot import many_functions
from tests.server.talk import Talk

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Server, ServerOptions, serve_in_thread
from uoarm.server._running import _short_collections
from uoarm.testing import patience

FUNCTIONS, CLIENTS = 300, 16
CPU_SECONDS = 0.05
"""Of the loop, in one step: a fourth of what one status of this robot took, of each client."""


@pytest.fixture(scope="module")
def large() -> Iterator[RobotManager]:
    with _short_collections(), RobotManager(loads(many_functions(FUNCTIONS), "large")) as robot:
        robot.listen(lambda event: None)  # the thread of its listeners is not of one test
        for number in range(FUNCTIONS):
            robot.request(f"f{number}")
        yield robot


@pytest.fixture
def crowded(
    large: RobotManager, longest_step: Callable[[str], float]
) -> Iterator[tuple[Server, Callable[[], float]]]:
    with serve_in_thread(large, ServerOptions(port=0)) as server:
        yield server, lambda: longest_step("uoarm-serve")


ASKED = {
    "status": ("Status", ""),
    "watch": ("Status", "watch"),
    "list": ("List", ""),
    "resolve": ("Resolve", "f7"),
    "resolve what is not there": ("Resolve", "f7x"),
    "stop": ("Stop", ""),
    "stop one input that is not there": ("Stop", "c0"),
    "stop watching": ("Status", "unwatch"),
    "kill what is not there": ("Kill", "c0"),
    "request": ("Request", "f7"),
    "request what is not there": ("Request", "f7x"),
    "call what is not there": ("Call", "f7x"),
    "send to what is not there": ("Data", "c0"),
    "take up what is not there": ("Resume", "x"),
    "the history": ("Configure", ""),
    "what can be had": ("Discover", ""),
}


@pytest.mark.parametrize(("op", "kind"), ASKED.values(), ids=ASKED.keys())
@pytest.mark.parametrize("binary", [False, True], ids=["json", "cbor"])
def test_no_step_of_the_loop_grows_with_the_robot(
    crowded: tuple[Server, Callable[[], float]], op: str, kind: str, *, binary: bool
) -> None:
    server, longest = crowded
    url = f"ws://127.0.0.1:{server.ports[0]}/"
    with ExitStack() as stack:
        clients = [stack.enter_context(Talk(url, binary=binary)) for _ in range(CLIENTS)]
        asked = [client.send(op, kind) for client in clients]
        kinds = {_kind_of_answer(client) for client in clients}
    assert len(asked) == CLIENTS
    assert len(kinds) == 1
    assert 0 < longest() < CPU_SECONDS


def _kind_of_answer(client: Talk) -> str:
    """Return whether the next answer is a Reply; it is read no further, which takes long."""
    while True:
        frame = client.socket.recv(timeout=patience())
        head = (frame.encode() if isinstance(frame, str) else frame)[:200]
        for kind in ("Reply", "Error"):
            if kind.encode() in head:
                return kind


def test_metrics_are_collected_beside_the_loop(
    crowded: tuple[Server, Callable[[], float]],
) -> None:
    server, longest = crowded
    with urlopen(f"http://127.0.0.1:{server.ports[0]}/metrics", timeout=patience()) as page:
        text = page.read().decode()
    assert text.count("uoarm_component_health{") == FUNCTIONS
    assert "uoarm_serve_clients 0.0" in text
    assert 0 < longest() < CPU_SECONDS
