"""A bridge in a host beside one in this process and bare Zenoh; and how its death is noticed."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from queue import SimpleQueue
from typing import Any

from bench.tables import at, microseconds, print_table, spread
from bench.turns import ROOT, module, running
from uoarm import RobotManager
from uoarm._host import RemoteBridge
from uoarm.bridge import Bridge
from uoarm.config import loads
from uoarm.errors import BridgeError
from uoarm.local import PythonBridge, PythonOptions
from uoarm.model import BridgeSpec, Endpoint, Health, MessageStructure, Role

PARTS = {"path": [str(ROOT / "bench")]}
OPTIONS = PythonOptions.of(PARTS)
SIZES = {"100 B": 100, "10 KB": 10_000, "1 MB": 1_000_000}
ANY = MessageStructure(True)
ROUNDS, DEATHS, SILENCE = 5, 7, 3.0

Trip = Callable[[bytes], object]


def main() -> None:
    """Print round trips, and how long each death takes to be noticed."""
    with ExitStack() as stack:
        trips = {
            "bare Zenoh, a thread at either end": stack.enter_context(_zenoh()),
            "in this process": stack.enter_context(_bridge(PythonBridge("far", OPTIONS))),
            "in a host": stack.enter_context(_bridge(_hosted())),
        }
        samples = {(name, size): list[float]() for name in trips for size in SIZES}
        for _ in range(ROUNDS):
            for size, octets in SIZES.items():
                for name, trip in trips.items():
                    count = 200 if octets < 1e6 else 40
                    samples[name, size] += microseconds(partial(trip, bytes(octets)), repeat=count)
    rows = [(name, *(spread(samples[name, size]) for size in SIZES)) for name in trips]
    print_table("Round trip (us, median / p99)", ("what", *SIZES), rows)
    print_table(
        f"Noticing a death (ms, silence {SILENCE:g} s)", ("what", "median", "worst"), _deaths()
    )


def _end(name: str, role: Role = Role.OUTPUT) -> Endpoint:
    return Endpoint("far", name, role, (f"_components:{name}",))


def _hosted() -> RemoteBridge:
    return RemoteBridge(BridgeSpec("far", "python", PARTS, {"silence": SILENCE}))


@contextmanager
def _bridge(bridge: Bridge) -> Iterator[Trip]:
    back: SimpleQueue[Any] = SimpleQueue()
    bridge.open_source(_end("echo"), ANY, back.put)
    sink = bridge.open_sink(_end("echo", Role.INPUT), ANY)

    def trip(octets: bytes) -> object:
        sink.send({"data": octets})
        return back.get()

    yield trip
    bridge.close()


@contextmanager
def _zenoh() -> Iterator[Trip]:
    """Give round trips over Zenoh and nothing else.

    A component may take as long as it likes, so that it cannot be called in Zenoh's own threads:
    a thread at either end takes what arrives, as in a host.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = f"unixsock-stream/{folder}/link"
        with _session(place, listen=True) as session:
            back: SimpleQueue[Any] = SimpleQueue()
            ready = threading.Event()
            _subscribe(session, "bench/back", back.put)

            def trip(octets: bytes) -> object:
                session.put("bench/there", octets, attachment=b"header")
                return back.get().payload.to_bytes()

            kept = session.liveliness().declare_subscriber(
                "bench/alive", lambda _: ready.set(), history=True
            )
            with running(module("bench.hosted", place), signal.SIGKILL):
                ready.wait(20)
                yield trip
            kept.undeclare()


@contextmanager
def _session(place: str, *, listen: bool) -> Iterator[Any]:
    import zenoh  # noqa: PLC0415 - only this one needs it bare

    from uoarm._host.transport.zenoh_transport import configuration  # noqa: PLC0415 - the same settings

    session = zenoh.open(configuration(place, listen=listen, timeout=10, lease=10))
    yield session
    session.close()  # type: ignore[no-untyped-call] # zenoh's stub says no more


def _subscribe(session: Any, key: str, take: Callable[[Any], object]) -> None:
    """Have samples handed to `take` in a thread of its own."""
    import zenoh  # noqa: PLC0415 - only this one needs it bare

    subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(128))

    def receive() -> None:
        with suppress(zenoh.ZError):  # the session is closed
            while True:
                take(subscriber.recv())

    threading.Thread(target=receive, daemon=True).start()


def _zenoh_echo(place: str) -> None:
    """Give back frames over Zenoh and nothing else, until killed."""
    with _session(place, listen=False) as session:

        def back(sample: Any) -> None:
            session.put("bench/back", sample.payload, attachment=sample.attachment)

        _subscribe(session, "bench/there", back)
        session.liveliness().declare_token("bench/alive")
        signal.pause()


def _deaths() -> list[tuple[str, ...]]:
    """Return a row for each way to die; hangs and stops are noticed by silence, so two suffice."""

    def hang(bridge: RemoteBridge) -> None:
        threading.Thread(target=_quietly, args=(bridge, "hang", 60), daemon=True).start()

    def signalled(number: int) -> Callable[[RemoteBridge], object]:
        return lambda bridge: os.kill(bridge.process, number)

    return [
        _row("killed (SIGKILL)", [_notice(signalled(signal.SIGKILL)) for _ in range(DEATHS)]),
        _row("stopped (SIGSTOP)", [_notice(signalled(signal.SIGSTOP)) for _ in range(2)]),
        _row("hangs with the interpreter lock", [_notice(hang) for _ in range(2)]),
        _row("killed, to the next provider's first message", _takeovers()),
    ]


def _row(name: str, seconds: list[float]) -> tuple[str, ...]:
    found = sorted(1000 * duration for duration in seconds)
    return name, f"{at(found, 0.5):,.1f}", f"{found[-1]:,.1f}"


def _quietly(bridge: RemoteBridge, service: str, value: int) -> None:
    try:
        bridge.call(_end(service, Role.SERVICE), value, timeout=30)
    except BridgeError:
        return  # the death that was asked for


def _notice(harm: Callable[[RemoteBridge], object]) -> float:
    bridge = _hosted()
    noticed = threading.Event()
    bridge.watch(lambda event: noticed.set() if event.health is Health.LOST else None)
    begun = time.perf_counter()
    harm(bridge)
    noticed.wait(30)
    took = time.perf_counter() - begun
    bridge.close()
    return took


ROBOT = f"""
version: 1
bridges:
  one: {{plugin: python, host: true, options: {{path: [{ROOT}/bench]}}}}
  two: {{plugin: python, host: true, options: {{path: [{ROOT}/bench]}}}}
functions:
  numbers:
    components:
      - {{name: first, bridge: one, priority: 2, output: {{endpoint: ["_components:slowly"]}}}}
      - {{name: second, bridge: two, priority: 1, output: {{endpoint: ["_components:slowly"]}}}}
  here: {{components: [{{name: f, bridge: two, output: {{endpoint: ["_components:slowly"]}}}}]}}
"""


def _takeovers() -> list[float]:
    """Each provider counts from 0, so that the next one's first message is known by its value."""
    found = []
    for _ in range(DEATHS):
        with RobotManager(loads(ROBOT)) as robot:
            begins: SimpleQueue[float] = SimpleQueue()

            def take(number: int, begins: SimpleQueue[float] = begins) -> None:
                if number == 0:
                    begins.put(time.perf_counter())

            robot.request("here").get(10)
            robot.request("numbers", on_message=take)
            begins.get(timeout=10)
            host = robot._bridges.get("one")  # noqa: SLF001 - to kill it
            assert isinstance(host, RemoteBridge)
            begun = time.perf_counter()
            os.kill(host.process, signal.SIGKILL)
            found.append(begins.get(timeout=10) - begun)
    return found


if __name__ == "__main__":
    if sys.argv[1:]:
        _zenoh_echo(sys.argv[1])
    else:
        main()
