"""A hosted `python` bridge with a few components, and what tests ask of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from uoarm._host.remote_bridge import RemoteBridge
from uoarm._host.transport import liveness
from uoarm.bridge import HealthEvent
from uoarm.model import BridgeSpec, Endpoint, MessageStructure, Role
from uoarm.testing import patience

COMPONENTS = """
import ctypes, os, sys, time
from collections.abc import Iterator

def count() -> Iterator[int]:
    yield from range(1000)

def forever() -> Iterator[int]:
    number = 0
    while True:
        yield number
        number += 1
        time.sleep(0.002)

def fails() -> Iterator[int]:
    yield 1
    raise RuntimeError("the camera is unplugged")

def double(value: int) -> int:
    return 2 * value

def refuse(value: int) -> int:
    raise ValueError(f"{value} is not wanted")

def slow(value: int) -> int:
    time.sleep(0.05)
    return value

def never(value: int) -> int:
    time.sleep(100_000)
    return value

def die(value: int) -> int:
    os._exit(value)

def hang(value: int) -> int:
    ctypes.PyDLL(None).sleep(value)  # keeps the interpreter lock
    return value

def crash(value: int) -> int:
    return len(ctypes.string_at(0))

def process_id(value: int) -> int:
    return os.getpid()

def turns(value: int) -> float:
    return sys.getswitchinterval()

class takes_long:
    def __init__(self) -> None:
        open(os.path.join(os.path.dirname(__file__), "begun"), "w").close()
        time.sleep(100_000)
    def __iter__(self) -> Iterator[int]:
        yield 1

class dies_young:
    def __init__(self) -> None:
        os.kill(os.getpid(), 9)
    def __iter__(self) -> Iterator[int]:
        yield 1

def shout(value: int) -> int:
    for _ in range(value):
        print("x" * 100_000)
    return value

def say(value: int) -> int:
    print("spoken", value)
    return value

hoard = []

def grow(value: int) -> int:
    hoard.append(bytearray(value * 2**20))
    return len(hoard)

def leak(value: int) -> int:
    global chain
    chain = ()  # a list could not grow any more, and what finds no place in it would be free again
    while True:
        for size in (*(2**n for n in range(value, 9, -1)), *range(512, 0, -16)):
            try:
                while True:
                    chain = (chain, bytes(size))
            except MemoryError:
                pass

def echo(message: dict) -> dict:
    return message

def ail(value: bool, **about: str) -> bool:
    import gc
    from uoarm.bridge import Bridge
    from uoarm.model import Health
    health, cause = (Health.DEGRADED, "it ails") if value else (Health.OK, "it is well")
    [bridge] = [found for found in gc.get_objects() if issubclass(type(found), Bridge)]
    bridge.report(health, cause, **about)
    return value

kept = []

def limp(value: int) -> int:
    # What opens from now on reports that it limps, before it is open; 0: what was opened, again.
    import gc
    from uoarm.bridge import Bridge, Capabilities, Channel, NativeLink
    from uoarm.model import Health
    [bridge] = [found for found in gc.get_objects() if issubclass(type(found), Bridge)]
    for channel in kept if not value else ():
        bridge.report_channel(channel, Health.DEGRADED, "it limps")
    def reporting(step):
        def report(*given):
            kept.append(step(*given))
            bridge.report_channel(kept[-1], Health.DEGRADED, "it limps")
            return kept[-1]
        return report
    if value:
        bridge._open_source = reporting(bridge._open_source)
        bridge._open_sink = reporting(bridge._open_sink)
        bridge.capabilities = Capabilities(call=True, serve=True, link=True)
        bridge._serve = reporting(lambda endpoint, *_: Channel(endpoint, list))
        bridge._link = reporting(lambda source, sink: NativeLink(source, sink, list))
    return value

def run_low(value: bool) -> bool:
    return ail(value, component="thing", about="battery")

def know(value: "int | None") -> int:
    from uoarm.bridge import Bridge
    Bridge.facts = lambda _: {"empty_turns": value + 0}
    return 0
"""

ANY = MessageStructure(True)


PATIENT = {
    "PYTHONPATH": str(Path(__file__).parent / "patient"),
    "UOARM_TEST_PATIENCE": str(patience()),
}
"""Variables with which a host gives up no message of a manager that is starved."""


def spec(folder: Path, **host: object) -> BridgeSpec:
    """Write the components to a folder and describe a hosted bridge that finds them."""
    (folder / "hosted_parts.py").write_text(COMPONENTS)
    patient = {"silence": patience(), "start": patience(), "variables": PATIENT}
    return BridgeSpec("far", "python", {"path": [str(folder)]}, patient | host)


def bridge(folder: Path, **host: object) -> RemoteBridge:
    """Start a hosted bridge."""
    return RemoteBridge(spec(folder, **host))


def hasten(bridge: RemoteBridge, silence: float) -> None:
    """Have a bridge give its host up after so long from now on.

    One that has such a silence from the beginning may take a host for dead that has not come to run
    yet, before the test has done anything to it.
    """
    heartbeat: Any = vars(bridge._host)["_heartbeat"]
    heartbeat._silence.limit = silence


def doubt_soon(patched: pytest.MonkeyPatch) -> None:
    """Have a host that does not answer doubted after two seconds, long before it is given up."""
    patched.setattr(liveness, "_DOUBT", 2.0 / patience())


def at(name: str, role: Role = Role.OUTPUT, port: str = "default") -> Endpoint:
    """Return the endpoint of a component in the hosted module."""
    return Endpoint("far", name, role, (f"hosted_parts:{name}",), port)


class Events:
    """Keeps the health events of a bridge."""

    def __init__(self) -> None:
        self.all: list[HealthEvent] = []

    def __call__(self, event: HealthEvent) -> None:
        self.all.append(event)
