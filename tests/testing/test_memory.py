"""The second bridge: unlike on both sides, strict about structures, and breakable on demand."""

from __future__ import annotations

import _thread
import threading

import pytest
from hypothesis import given
from tests.structures import closed

from uoarm import RobotManager
from uoarm._support.workers import WorkerPool
from uoarm.bridge import HealthEvent
from uoarm.config import loads
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    MessageError,
    ResolutionError,
)
from uoarm.model import Endpoint, Health, MessageStructure, Role
from uoarm.testing import (
    Background,
    Collector,
    ManualClock,
    MemoryBridge,
    ResourceSnapshot,
    hanging,
    instances,
    lying,
    patience,
    raising,
    wait,
)
from uoarm.testing._components import PAIRS, ROWS, NativeDialect, codec

BYTE = closed(value={"type": "integer", "minimum": 0, "maximum": 255})
SHORT = closed(value={"type": "integer", "minimum": -32768, "maximum": 32767})
MIXED = closed(
    count={"type": "integer"},
    names={"type": "array", "items": {"type": "string"}},
    pair={
        "type": "array",
        "prefixItems": [{"type": "boolean"}, {"type": "null"}],
        "items": False,
        "minItems": 2,
    },
    free={},
)
ROBOT = """
version: 1
bridges: {memory: {}}
functions:
  camera:
    components: [{name: camera, bridge: memory, output: {endpoint: [camera]}}]
  viewer:
    components:
      - {name: screen, bridge: memory, input: {from: camera, endpoint: [screen]},
         output: {endpoint: [picture]}}
"""


def output(name: str) -> Endpoint:
    return Endpoint("memory", name, Role.OUTPUT, (name,))


def sink_of(name: str) -> Endpoint:
    return Endpoint("memory", name, Role.INPUT, (name,))


@pytest.mark.parametrize("dialect", [ROWS, PAIRS], ids=["rows", "pairs"])
@given(message=instances(MIXED))
def test_what_is_written_natively_reads_back(dialect: NativeDialect, message: object) -> None:
    both = codec(MIXED, dialect)
    assert both.read(both.write(message)) == message


def test_producers_and_consumers_have_nothing_in_common() -> None:
    message = {"value": 258}
    assert codec(SHORT, ROWS).write(message) == ("258",)
    assert codec(SHORT, PAIRS).write(message) == (("value", b"\x01\x02"),)
    with pytest.raises(BridgeError, match="reading failed"):
        codec(SHORT, PAIRS).read(codec(SHORT, ROWS).write(message))


@pytest.mark.parametrize(
    "message", [{}, {"value": 1, "more": 2}, {"value": True}, {"value": 1.5}, [1], None]
)
def test_what_does_not_fit_the_structure_is_refused(message: object) -> None:
    with pytest.raises(MessageError, match="writing a message failed"):
        codec(BYTE, ROWS).write(message)


def test_a_port_is_opened_only_with_its_own_structure() -> None:
    bridge = MemoryBridge()
    bridge.taker("screen", SHORT)
    with pytest.raises(BridgeError, match="another port"):
        bridge.open_sink(sink_of("screen"), MessageStructure(BYTE))
    assert bridge.open_channels == 0
    bridge.close()


def robot(bridge: MemoryBridge, text: str = ROBOT) -> RobotManager:
    return RobotManager(loads(text), bridges={"memory": bridge})


def test_a_chain_through_the_manager_is_opened_with_the_structure_of_each_side() -> None:
    bridge = MemoryBridge()
    camera, screen = bridge.emitter("camera", BYTE), bridge.taker("screen", SHORT)
    bridge.emitter("picture", BYTE)
    with robot(bridge) as manager, manager.request("viewer"):
        camera.emit({"value": 255})
        assert screen.taken.wait(1) == [{"value": 255}]


def test_the_manager_compares_producer_with_consumer_in_this_direction_only() -> None:
    bridge = MemoryBridge()
    bridge.emitter("camera", SHORT)
    bridge.taker("screen", BYTE)
    bridge.emitter("picture", BYTE)
    with robot(bridge) as manager, pytest.raises(ResolutionError, match="value"):
        manager.request("viewer")
    assert bridge.open_channels == 0


def test_a_component_that_dies_ends_the_connections_that_need_it() -> None:
    bridge = MemoryBridge()
    bridge.emitter("camera", BYTE)
    bridge.taker("screen", SHORT)
    bridge.emitter("picture", BYTE)
    states = Collector()
    with robot(bridge) as manager, manager.request("viewer") as connection:
        manager.listen(lambda event: states.deliver((event.subject, event.change)))
        bridge.die("camera", "unplugged")
        ended = (f"connection {connection.id}", "failed")
        while ended not in states.messages:
            states.wait(len(states.messages) + 1)
        assert bridge.open_channels == 0


def test_garbled_messages_are_counted_and_the_link_goes_on() -> None:
    bridge, got = MemoryBridge(), Collector()
    camera = bridge.emitter("camera", BYTE)
    channel = bridge.open_source(output("camera"), MessageStructure(BYTE), got.deliver)
    with camera.garbled():
        camera.emit({"value": 1})
    camera.emit({"value": 2})
    assert got.messages == [{"value": 2}]
    assert channel.unreadable == 1
    bridge.close()


def test_nothing_passes_a_link_that_is_cut() -> None:
    bridge, got, reports = MemoryBridge(), Collector(), list[HealthEvent]()
    camera, screen = bridge.emitter("camera", BYTE), bridge.taker("screen", BYTE)
    bridge.watch(reports.append)
    bridge.open_source(output("camera"), MessageStructure(BYTE), got.deliver)
    sink = bridge.open_sink(sink_of("screen"), MessageStructure(BYTE))
    bridge.cut("unplugged")
    camera.emit({"value": 1})
    with pytest.raises(BridgeError, match="unplugged"):
        sink.send({"value": 1})
    bridge.mend()
    camera.emit({"value": 2})
    sink.send({"value": 2})
    assert got.messages == screen.taken.messages == [{"value": 2}]
    assert [event.health for event in reports] == [Health.DEGRADED] * 2 + [Health.OK] * 2
    bridge.close()


def test_a_stalled_taker_holds_up_its_sender_until_released() -> None:
    bridge = MemoryBridge()
    screen = bridge.taker("screen", BYTE)
    sink = bridge.open_sink(sink_of("screen"), MessageStructure(BYTE))
    with screen.stalled() as stall:
        sending = Background(lambda: sink.send({"value": 1}))
        assert stall.entered.wait(patience())
        assert screen.taken.messages == []
    sending.result()
    assert screen.taken.messages == [{"value": 1}]
    bridge.close()


def test_a_natively_linked_pair_needs_no_route() -> None:
    bridge = MemoryBridge(links=True)
    camera, screen = bridge.emitter("camera", BYTE), bridge.taker("screen", BYTE)
    channel = bridge.link(output("camera"), sink_of("screen"))
    assert channel is not None
    camera.emit({"value": 3})
    bridge.cut()
    camera.emit({"value": 4})
    bridge.mend()
    camera.emit({"value": 5})
    channel.close()
    camera.emit({"value": 6})
    assert screen.taken.messages == [{"value": 3}, {"value": 5}]
    bridge.close()


def test_death_is_reported_on_every_open_channel() -> None:
    bridge, events = MemoryBridge(), Collector()
    bridge.watch(events.deliver)
    bridge.emitter("camera", BYTE)
    channel = bridge.open_source(output("camera"), MessageStructure(BYTE), Collector().deliver)
    bridge.die("camera", "unplugged")
    (event,) = events.messages
    assert isinstance(event, HealthEvent)
    assert (event.health, event.cause, event.channel) == (Health.LOST, "unplugged", channel)
    bridge.close()


def test_faults_replace_a_step_and_give_it_back() -> None:
    bridge = MemoryBridge()
    bridge.emitter("camera", BYTE)
    with raising(bridge, "_describe", OSError("offline")), pytest.raises(BridgeError) as caught:
        bridge.describe(output("camera"))
    assert isinstance(caught.value.__cause__, OSError)
    with lying(bridge, "_describe", None), pytest.raises(BridgeError, match="contract"):
        bridge.describe(output("camera"))
    with hanging(bridge, "_describe") as hang:
        with pytest.raises(BridgeTimeoutError):
            bridge.describe(output("camera"), timeout=0.02)
        assert hang.entered.wait(patience())
    assert bridge.describe(output("camera")).message is not None
    with pytest.raises(ValueError, match="no step '_sing'"), raising(bridge, "_sing", OSError()):
        pass
    bridge.close()


def test_a_manual_clock_moves_forward_only() -> None:
    clock = ManualClock(5.0)
    assert clock.advance(1.5) == clock.now() == clock() == 6.5
    with pytest.raises(ValueError, match="-1"):
        clock.advance(-1)


def test_a_snapshot_does_not_wait_for_threads_that_python_did_not_start() -> None:
    snapshot = ResourceSnapshot()
    known, gate = threading.Event(), threading.Event()

    def call_into_python() -> None:
        threading.current_thread()
        known.set()
        gate.wait(patience())

    _thread.start_new_thread(call_into_python, ())
    assert known.wait(patience())
    snapshot.check()
    gate.set()


def test_a_snapshot_names_the_threads_that_stay() -> None:
    snapshot = ResourceSnapshot()
    with hanging(MemoryBridge(), "_close") as hang:
        Background(hang.wait)
        with pytest.raises(AssertionError, match="uoarm-test"):
            snapshot.check(timeout=0.02)
    snapshot.check()


def test_a_snapshot_does_not_wait_for_threads_of_a_pool_that_end_by_themselves() -> None:
    snapshot = ResourceSnapshot()
    pool, gate = WorkerPool("pool", idle_seconds=patience()), threading.Event()
    pool.submit(gate.wait)
    with pytest.raises(AssertionError, match="1 threads are left over: pool"):
        snapshot.check(timeout=0.02)
    gate.set()
    wait(lambda: not pool.busy)
    snapshot.check(timeout=0)
    pool.close()
    snapshot.check()


def test_a_snapshot_takes_one_thread_in_the_place_of_another_that_has_ended() -> None:
    """As where one reads on while the one that read before is stuck in a receiver."""
    gates = [threading.Event() for _ in range(3)]
    readers = [threading.Thread(target=gate.wait, name="reader") for gate in gates]
    readers[0].start()
    snapshot = ResourceSnapshot()
    readers[1].start()
    with pytest.raises(AssertionError, match="1 threads are left over: reader"):
        snapshot.check(timeout=0.02)
    gates[0].set()
    readers[0].join()
    snapshot.check()
    readers[2].start()
    with pytest.raises(AssertionError, match="1 threads are left over: reader"):
        snapshot.check(timeout=0.02)
    for gate in gates:
        gate.set()


def test_a_snapshot_waits_for_a_thread_that_is_about_to_begin() -> None:
    gate = threading.Event()

    class Late(threading.Thread):
        """Is among the threads, as on a starved machine, long before it runs."""

        def _bootstrap(self) -> None:
            assert gate.wait(patience())
            super()._bootstrap()  # type: ignore[misc]  # every version of Python calls it so

    snapshot = ResourceSnapshot()
    late = Late(target=int, name="late")
    begins = threading.Thread(target=late.start)
    begins.start()
    wait(lambda: late in threading.enumerate())
    with pytest.raises(AssertionError, match=r"left over: .*late"):
        snapshot.check(timeout=0.02)
    gate.set()
    snapshot.check()


def test_a_snapshot_counts_the_descriptors_that_stay() -> None:
    snapshot = ResourceSnapshot()
    with open(__file__), pytest.raises(AssertionError, match="1 file descriptors"):  # noqa: PTH123
        snapshot.check(timeout=0.0)
    snapshot.check()


def test_a_collector_sees_deliveries_that_overlap() -> None:
    got = Collector()
    with got.held():
        both = [Background(lambda: got.deliver(1)), Background(lambda: got.deliver(2))]
        got.wait_begun(2)
        assert got.messages == []
    for background in both:
        background.result()
    assert got.overlaps == 1
    with pytest.raises(AssertionError, match="2 of 3"):
        got.wait(3, timeout=0.0)
