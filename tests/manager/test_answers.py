"""The answer of a send says what the sink did, where nothing is between them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from uoarm import RobotManager
from uoarm.bridge import Registry, Sink
from uoarm.config import loads
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Endpoint, Message, MessageStructure
from uoarm.testing import Emitter, MemoryBridge

ROBOT = """
version: 1
bridges: {memory: {plugin: memory}}
functions:
  board: {components: [{name: board, bridge: memory, input: {endpoint: [board]}}]}
  given: {components: [{name: giver, bridge: memory, output: {endpoint: [giver]}}]}
  seen:
    components:
      - name: eye
        bridge: memory
        input: {from: given, endpoint: [board]}
        output: {endpoint: [eye]}
"""


class Fussy(MemoryBridge):
    """Its sinks do not block, and refuse what their framework has no form for."""

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        def send(message: Message) -> None:
            if message == "large":
                raise MessageError("the payload has 9 octets; 4 are allowed")
            if message == "away":
                raise BridgeError("the broker is away", FailureReason.UNAVAILABLE)
            if message == "odd":
                raise ValueError("no author thought of it")

        return Sink(endpoint, send, lambda: None, blocking=False)


@pytest.fixture
def memory() -> Fussy:
    made = Fussy()
    made.taker("board", {"type": "string"})
    made.emitter("eye", {"type": "string"})
    return made


@pytest.fixture
def giver(memory: Fussy) -> Emitter:
    return memory.emitter("giver", {"type": "string"})


@pytest.fixture
def robot(memory: Fussy, giver: Emitter) -> Iterator[RobotManager]:
    bridges = {"memory": memory}
    del giver  # made by now
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges=bridges) as robot:
        yield robot


def test_what_a_sink_discards_is_an_error_of_the_send(robot: RobotManager) -> None:
    board = robot.request("board")
    board.send("fine")
    with pytest.raises(MessageError, match=r"^board\.default: the payload has 9 octets"):
        board.send("large")
    with pytest.raises(BridgeError, match=r"^the broker is away$"):
        board.send("away")
    with pytest.raises(BridgeError, match=r"^board\.default raised ValueError: no author thought"):
        board.send("odd")
    [route] = board.routes()
    assert (route.delivered, route.dropped) == (1, (("failed", 2), ("invalid", 1)))


@pytest.mark.parametrize(
    ("message", "why"), [("large", "the payload has 9 octets"), ("away", "the broker is away")]
)
def test_a_silence_names_what_was_refused_last(
    robot: RobotManager, giver: Emitter, message: str, why: str
) -> None:
    seen = robot.request("seen")
    giver.emit(message)
    refusal = rf"giver\.default -> eye\.default was refused: .*{why}"
    with pytest.raises(TimeoutError, match=refusal):
        seen.get(0.001)
    [route] = robot.status().routes[:1]
    assert why in route.refusal
    giver.emit("fine")
    with pytest.raises(TimeoutError, match=r"no message within 0\.001 s$"):
        seen.get(0.001)
