"""Who takes the frames of a link: the thread that reads, unless that would hold others up."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue

import pytest

from uoarm._host.transport import socket_transport
from uoarm._host.transport.codec import Frame
from uoarm._host.transport.frames import LinkSockets
from uoarm._host.transport.socket_transport import FlowSubscription, FrameFlows
from uoarm.testing import patience, wait

LONG = bytes(2**16 + 1)
QUICK = 100  # in a row, after which a flow needs no thread of its own

Ends = tuple[FrameFlows, FrameFlows]


@pytest.fixture
def flows(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ends]:
    """Both ends; what is called quick here is what does not wait for a gate."""
    monkeypatch.setattr(socket_transport, "_QUICK_SECONDS", patience())
    one, other = LinkSockets.make()
    near = FrameFlows(one.incoming, one.outgoing, "near", lambda: None)
    far = FrameFlows(other.incoming, other.outgoing, "far", lambda: None)
    yield near, far
    near.close()
    far.close()
    one.requests.close()
    other.requests.close()


class _Taker:
    """Takes frames, notes in which thread, and hangs with each whose payload is `hang`."""

    def __init__(self, end: FrameFlows, key: str = "one") -> None:
        self.got: list[bytes] = []
        self.threads: list[int] = []
        self.hangs, self.gate = threading.Event(), threading.Event()
        self.end = end.subscribe(key, 1000, self._take, f"takes-{key}")

    def _take(self, payload: Frame, header: bytes) -> None:
        self.threads.append(threading.get_ident())
        if payload == b"hang":
            self.hangs.set()
            assert self.gate.wait(patience())
        self.got.append(header)
        if payload == b"fail":
            raise ValueError("it failed")


def _send(end: FrameFlows, *headers: int, payload: bytes = b"", key: str = "one") -> None:
    for number in headers:
        end.write(key, b"%d" % number, payload, patience())


def _numbers(*headers: int) -> list[bytes]:
    return [b"%d" % number for number in headers]


def test_what_is_quick_is_taken_in_the_thread_that_reads(flows: Ends) -> None:
    near, far = flows
    one, other = _Taker(near), _Taker(near, "other")
    _send(far, *range(50))
    _send(far, *range(50), key="other")
    wait(lambda: len(other.got) == 50)
    assert one.got == other.got == _numbers(*range(50))
    assert len({*one.threads, *other.threads}) == 1


def test_where_one_hangs_another_thread_reads_on_and_order_is_kept(flows: Ends) -> None:
    near, far = flows
    one, other = _Taker(near), _Taker(near, "other")
    _send(far, 0, payload=b"hang")
    assert one.hangs.wait(patience())
    _send(far, 1, 2)
    _send(far, 1, key="other")
    wait(lambda: other.got == _numbers(1))
    assert one.got == []
    one.gate.set()
    wait(lambda: len(one.got) == 3)
    assert one.got == _numbers(0, 1, 2)
    assert len(set(one.threads)) == 1
    assert other.threads[0] != one.threads[0]


def test_two_that_hang_hold_up_no_third(flows: Ends) -> None:
    near, far = flows
    takers = [_Taker(near, key) for key in ("a", "b", "c")]
    for key in ("a", "b"):
        _send(far, 0, payload=b"hang", key=key)
    _send(far, 0, key="c")
    wait(lambda: takers[2].got)
    for taker in takers:
        taker.gate.set()
    wait(lambda: all(taker.got for taker in takers))


def test_what_is_quick_again_goes_back_to_the_thread_that_reads(flows: Ends) -> None:
    near, far = flows
    taker, other = _Taker(near), _Taker(near, "other")
    _send(far, 0, payload=b"hang")
    assert taker.hangs.wait(patience())
    _send(far, 0, key="other")
    wait(lambda: other.got)  # another thread reads
    taker.gate.set()
    numbers = 0

    def is_back() -> bool:
        nonlocal numbers
        numbers += 1
        _send(far, numbers)
        wait(lambda: len(taker.got) == numbers + 1)
        return taker.threads[-1] == other.threads[-1]

    wait(is_back)
    assert taker.got == _numbers(*range(numbers + 1))
    assert numbers >= QUICK


def test_who_takes_its_time_has_a_thread_of_its_own(
    flows: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = flows
    monkeypatch.setattr(socket_transport, "_QUICK_SECONDS", 0.0)
    taker, other = _Taker(near), _Taker(near, "other")
    _send(far, *range(10))
    _send(far, 0, payload=LONG, key="other")  # long ones have one from the first on
    wait(lambda: len(taker.got) == 10 and other.got)
    assert taker.got == _numbers(*range(10))
    reading, own = taker.threads[0], taker.threads[-1]
    assert taker.threads == [reading] * 3 + [own] * 7
    assert len({reading, own, *other.threads}) == 3


def test_what_raises_is_reported_and_the_next_one_is_taken(
    flows: Ends, caplog: pytest.LogCaptureFixture
) -> None:
    near, far = flows
    taker = _Taker(near)
    _send(far, 1, payload=b"fail")
    _send(far, 2)
    wait(lambda: len(taker.got) == 2)
    assert "it failed" in caplog.text


def test_two_ends_that_take_by_writing_lose_nothing_on_a_full_link(
    flows: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each end's thread that reads waits for room which only the other one's can make."""
    count, payload = 200, bytes(2**14)
    back: dict[FrameFlows, list[bytes]] = {end: [] for end in flows}
    for end in flows:

        def give_back(frame: Frame, header: bytes, end: FrameFlows = end) -> None:
            end.write("back", header, frame, patience())

        def note(frame: Frame, header: bytes, end: FrameFlows = end) -> None:
            back[end].append(header)

        end.subscribe("forth", count, give_back, "test")
        end.subscribe("back", count, note, "test")
    # Only who writes finds out, no one who looks from time to time.
    monkeypatch.setattr(socket_transport, "_LOOK_SECONDS", 10 * patience())

    def send(end: FrameFlows) -> None:
        for number in range(count):
            end.write("forth", b"%d" % number, payload, patience())

    sending = [threading.Thread(target=send, args=(end,)) for end in flows]
    for thread in sending:
        thread.start()
    for thread in sending:
        thread.join(patience())
    wait(lambda: all(len(item) == count for item in back.values()))
    assert all(item == _numbers(*range(count)) for item in back.values())


def test_an_end_in_the_midst_of_a_take_does_not_wait(flows: Ends) -> None:
    near, far = flows
    taker = _Taker(near)
    _send(far, 0, payload=b"hang")
    assert taker.hangs.wait(patience())
    _send(far, 1)
    taker.end()
    near.close()
    taker.gate.set()
    wait(lambda: taker.got == _numbers(0))
    reading = taker.threads[0]
    wait(lambda: all(thread.ident != reading for thread in threading.enumerate()))
    assert taker.got == _numbers(0)


def test_the_oldest_that_wait_are_lost_first() -> None:
    got: SimpleQueue[bytes] = SimpleQueue()
    gate = threading.Event()

    def take(payload: Frame, header: bytes) -> None:
        gate.wait(patience())
        got.put(header)

    kept = FlowSubscription(take, 2, "test")
    for number in range(5):
        assert not kept.begin(LONG, b"%d" % number)
        if not number:
            wait(kept._waiting.empty)
    gate.set()
    assert [got.get(timeout=patience()) for _ in range(3)] == _numbers(0, 3, 4)
    kept.end()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux counts switches")
def test_the_thread_that_reads_sleeps_on_when_what_was_written_is_taken(flows: Ends) -> None:
    """Were one socket read and written, the kernel would wake it for each frame."""
    near, far = flows
    taker = _Taker(far)
    status = Path(f"/proc/self/task/{near._reading.native_id}/status")

    def switches() -> int:
        lines = status.read_text().splitlines()
        return int(next(line.split()[1] for line in lines if line.startswith("voluntary_ctxt")))

    before = switches()
    for number in range(200):
        _send(near, number)
        wait(lambda number=number: len(taker.got) == number + 1)  # type: ignore[misc]
    assert switches() - before < 20
