"""A robot of plain Python components, and servers before it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.server.browser import Browser, find_chromium
from tests.server.robot import CONFIGURATION, script
from tests.server.serving import servers
from tests.server.talk import Talk
from websockets.asyncio.server import ServerConnection

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Server
from uoarm.testing import MemoryBridge, Proxy

Serve = Callable[..., Server]
Connect = Callable[..., Talk]
Between = Callable[[Server], Proxy]
Visit = Callable[..., None]
Hurry = Callable[[float], AbstractContextManager[None]]


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    script.reset()
    manager = RobotManager(loads(CONFIGURATION, origin=str(Path(__file__).parent / "robot.yaml")))
    yield manager
    script.release()
    manager.close()


@pytest.fixture
def memory() -> MemoryBridge:
    return MemoryBridge()


@pytest.fixture
def serve(robot: RobotManager) -> Iterator[Serve]:
    with servers(robot) as start:
        yield start


@pytest.fixture
def hurry(monkeypatch: pytest.MonkeyPatch) -> Hurry:
    """Have a server that starts later give up those who connect in a block after so many seconds.

    The others have the limits of the server, which a machine that is starved does not reach.
    """
    given: dict[str, float] = {}
    make = Server._make_connection

    def make_connection(server: Server, *arguments: Any, **options: Any) -> ServerConnection:
        return make(server, *arguments, **(options | given))

    @contextmanager
    def within(seconds: float) -> Iterator[None]:
        given.update(ping_interval=seconds / 4, ping_timeout=seconds)
        yield
        given.clear()

    monkeypatch.setattr(Server, "_make_connection", make_connection)
    return within


@pytest.fixture
def server(serve: Serve) -> Server:
    return serve()


@pytest.fixture
def talk(server: Server) -> Iterator[Connect]:
    """Connect a client to the server."""
    with ExitStack() as stack:

        def connect(path: str = "/", **options: Any) -> Talk:
            url = f"ws://127.0.0.1:{server.ports[0]}{path}"
            return stack.enter_context(Talk(url, **options))

        yield connect


@pytest.fixture
def between() -> Iterator[Between]:
    """Put a proxy before a server."""
    with ExitStack() as stack:
        yield lambda server: stack.enter_context(Proxy(server.ports[0]))


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    program = find_chromium()
    assert program is not None
    with Browser(program) as browser:
        yield browser


@pytest.fixture
def browser(chromium: Browser, serve: Serve) -> Iterator[Browser]:
    """A page that must not complain and must not ask any other server for anything.

    It is left before servers end: `serve` comes first, so it goes last.
    """
    del serve
    chromium.requests.clear()
    chromium.complaints.clear()
    chromium.show(1280, 800)
    yield chromium
    chromium.go("about:blank")
    assert chromium.complaints == []
    strange = [url for url in chromium.requests if "//127.0.0.1:" not in url]
    assert [url for url in strange if not url.startswith(("data:", "about:"))] == []


@pytest.fixture
def visit(browser: Browser, server: Server) -> Visit:
    def visit(place: str = "") -> None:
        browser.go(f"http://127.0.0.1:{server.ports[0]}/{place}")
        browser.until("document.querySelector('.link-state.open')")

    return visit
