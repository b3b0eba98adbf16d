"""One client that has a thousand functions open: all are accepted, and all of them come."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import Mock

import pytest
from tests.server.conftest import Serve
from tests.server.talk import Talk

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.server.session import _native
from uoarm.testing import MemoryBridge

COUNT = 1000
ONE = "  f{0}: {{components: [{{name: c{0}, bridge: memory, output: {{endpoint: [c{0}]}}}}]}}\n"
ROBOT = "version: 1\nbridges: {memory: {plugin: python}}\nfunctions:\n"


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    """Each function has one message, its number, for each client that opens it."""
    memory = MemoryBridge()
    for number in range(COUNT):
        memory.emitter(f"c{number}", {"type": "integer"}, latched=True).emit(number)
    config = loads(ROBOT + "".join(map(ONE.format, range(COUNT))))
    with RobotManager(config, registry=Registry(()), bridges={"memory": memory}) as robot:
        yield robot


def test_a_thousand_functions_asked_at_once_are_all_opened(
    serve: Serve, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Mock(wraps=robot.status)
    monkeypatch.setattr(robot, "status", whole)
    looks = Mock(side_effect=_native._KINDS.get)
    monkeypatch.setattr(_native, "_KINDS", Mock(get=looks))
    server = serve()
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as client:
        asked = [client.send("Request", f"f{number}") for number in range(COUNT)]
        opened = [client.answer(name)["jsonMessage"]["connection"] for name in asked]
        came = {connection: client.data(connection, 1) for connection in opened}
    assert came == {connection: [number] for number, connection in enumerate(opened)}
    assert not whole.called, "what each opening looks at does not grow with what is open"
    assert looks.call_count == COUNT
