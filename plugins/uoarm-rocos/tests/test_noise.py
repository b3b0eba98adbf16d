"""Noise on a real tty: random octets, cut and interleaved frames, unexpected messages."""

from __future__ import annotations

import random
import select
import time
import tracemalloc
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from threading import Event, Lock, Thread
from typing import Any

import pytest
from attrs import evolve
from lines import LIMIT, PseudoTerminal
from rigs import bridged, endpoint
from typing_extensions import Self
from uoarm_rocos._catalogue import (
    CallMessage,
    CatalogueMessage,
    CloseMessage,
    DataMessage,
    DescribeMessage,
    Direction,
    ErrorCode,
    ErrorMessage,
    HeartbeatMessage,
    OpenMessage,
    ResultMessage,
    WireMessage,
)
from uoarm_rocos._codec import XmlCodec
from uoarm_rocos._framing import StuffedFramer
from uoarm_rocos.devices._oximeters import contec_frame, nonin1_frame, nonin2_packet
from uoarm_rocos.simulate import robot_catalogue

from uoarm.model import MessageStructure

ANY = MessageStructure(True)
PULSE = endpoint("clip", "pulseOximetry")
ODOMETRY = endpoint("robot", "odometry")
OCTETS = 300_000
GOOD = {"x": 1.0, "y": 2.0, "heading": 0.5}
CODEC = XmlCodec()
CATALOGUE = CatalogueMessage(0, 0, robot_catalogue())
FRAMES = {
    "contec-cms50dplus": contec_frame(pulse=77, spo2=97),
    "nonin-1": nonin1_frame(rate=77, spo2=97),
    "nonin-2": b"".join(nonin2_packet([1] * 25, rate=77, spo2=97)),
}


def noise(frames: list[bytes], octets: int, seed: int) -> Iterator[bytes]:
    """Yield random octets, and frames cut short, damaged, repeated and laid into each other."""
    chance = random.Random(seed)
    sent = 0
    while sent < octets:
        frame = chance.choice(frames)
        other = chance.choice(frames)
        cut = chance.randrange(len(frame))
        part = chance.choice(
            [
                chance.randbytes(chance.randrange(1, 200)),
                frame[:cut],
                frame[cut:],
                frame[:cut] + other + frame[cut:],
                bytes(x for pair in zip(frame, other, strict=False) for x in pair),
                frame[:cut] + bytes([frame[cut] ^ 1 << chance.randrange(8)]) + frame[cut + 1 :],
                b"\x7e" * chance.randrange(1, 50),
                b"\x00" * 100,
            ]
        )
        sent += len(part)
        yield part


def no_traceback(caplog: pytest.LogCaptureFixture) -> None:
    assert [record for record in caplog.records if record.exc_info] == []


@pytest.mark.parametrize("driver", FRAMES)
def test_an_oximeter_is_read_again_after_noise_that_is_counted_and_not_kept(
    driver: str, caplog: pytest.LogCaptureFixture
) -> None:
    frame = FRAMES[driver]
    newest: deque[Any] = deque(maxlen=1)
    with (
        PseudoTerminal() as device,
        bridged(clip={"driver": driver, "url": device.path}) as (bridge, _),
    ):
        clip = bridge._named("clip")  # type: ignore[attr-defined]  # of this bridge
        until(lambda: clip._line._transport is not None)
        device.write(frame * 3)
        channel = bridge.open_source(PULSE, ANY, newest.append)
        tracemalloc.start()
        try:
            for part in noise([frame], OCTETS, 1):
                device.write(part)
            _, most = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        until(lambda: write_and_see(device, frame, newest))
        assert int(str(channel.facts()["discarded"])) > OCTETS / 10
        assert most < OCTETS * 10
    no_traceback(caplog)


def test_a_device_of_the_profile_is_understood_after_noise_and_unexpected_messages(
    caplog: pytest.LogCaptureFixture,
) -> None:
    newest: deque[Any] = deque(maxlen=1)
    with PseudoTerminal() as device, bridged(robot={"url": device.path}) as (bridge, _):
        with Peer(device) as peer:
            channel = bridge.open_source(ODOMETRY, ANY, newest.append)
            for part in noise([peer.framed(item) for item in unawaited()], OCTETS, 2):
                device.write(part)

            def understood() -> bool:
                peer.say(lambda seq: DataMessage(seq, peer.flow, GOOD))
                return bool(newest) and newest.pop() == GOOD

            until(understood)
        damaged = bridge._devices["robot"].facts()["damaged"]  # type: ignore[attr-defined]
        assert damaged > 100
        assert channel.facts() is not None
    no_traceback(caplog)


def unawaited() -> list[WireMessage]:
    """Messages that are whole, and that no device may send now."""
    ids = (0, 1, 2, 3, 77, 2**32 - 1)
    return [
        *(ResultMessage(seq, id_, {}) for seq, id_ in enumerate(ids)),
        *(DataMessage(seq, id_, {}) for seq, id_ in enumerate(ids) if id_ > 3),
        *(
            OpenMessage(seq, id_, "odometry", Direction.INPUT)
            for seq, id_ in enumerate(ids)
            if id_ > 3
        ),
        *(CloseMessage(seq, id_) for seq, id_ in enumerate(ids) if id_ > 3),
        *(ErrorMessage(seq, id_, ErrorCode.BUSY, "x") for seq, id_ in enumerate(ids) if id_ > 3),
        CallMessage(5, 77, "odometry", {}),
        DescribeMessage(6, 77),
        HeartbeatMessage(7),
    ]


class Peer:
    """A device that answers each greeting, and says beside what the test has it say."""

    def __init__(self, device: PseudoTerminal) -> None:
        self._device = device
        self._framer = StuffedFramer()
        self._stop = Event()
        self._saying = Lock()
        self._seq = 0
        self._thread = Thread(target=self._greet, daemon=True)
        self.flow = 0

    def framed(self, message: WireMessage) -> bytes:
        return self._framer.frame(CODEC.write(message))

    def say(self, message: Callable[[int], WireMessage]) -> None:
        with self._saying:
            self._device.write(self.framed(message(self._seq)))
            self._seq += 1

    def _greet(self) -> None:
        while not self._stop.is_set():
            if not select.select([self._device], [], [], 0.05)[0]:
                continue
            for frame in self._framer.feed(self._device.read_some()):
                asked = CODEC.read(frame)
                if isinstance(asked, DescribeMessage):
                    self.say(partial(_answer, CATALOGUE, asked.id))
                elif isinstance(asked, OpenMessage):
                    self.say(partial(_answer, asked, asked.id))
                    self.flow = asked.id

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join(LIMIT)


def _answer(message: CatalogueMessage | OpenMessage, number: int, seq: int) -> WireMessage:
    return evolve(message, id=number, seq=seq)


def write_and_see(device: PseudoTerminal, frame: bytes, newest: deque[Any]) -> bool:
    device.write(frame)
    return bool(newest) and newest.pop().get("pulse") == 77


def until(condition: Any) -> None:
    end = time.monotonic() + 12 * LIMIT
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)
