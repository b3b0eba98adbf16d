"""The queues of one client: replies first, streams in turn, everything bounded and counted."""

from __future__ import annotations

import asyncio
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.calls import calls_of

from uoarm.model import OverflowPolicy, QueuePolicy
from uoarm.server.streams._memory import ServerMemory
from uoarm.server.streams._outbox import Lane, Outbox
from uoarm.testing import patience


def lane(length: int = 100, policy: OverflowPolicy = OverflowPolicy.DROP_OLDEST) -> Lane:
    return Lane(QueuePolicy(length, policy), text=True)


async def drain(outbox: Outbox) -> list[bytes]:
    frames = []
    while not outbox.empty:
        frames.append((await outbox.next())[0][0])
    return frames


async def test_replies_overtake_data_and_streams_take_turns() -> None:
    outbox = Outbox(1000, 10)
    one, two = lane(), lane()
    for frame in (b"a1", b"a2", b"a3"):
        outbox.put(one, frame)
    outbox.put(two, b"b1")
    outbox.reply(b"reply", text=True)
    assert await drain(outbox) == [b"reply", b"a1", b"b1", b"a2", b"a3"]
    assert (one.sent, two.sent) == (3, 1)


@pytest.mark.parametrize(
    ("policy", "length", "kept"),
    [(OverflowPolicy.LATEST, 5, [b"4"]), (OverflowPolicy.DROP_OLDEST, 3, [b"2", b"3", b"4"])],
)
async def test_a_full_stream_drops_its_oldest_and_counts(
    policy: OverflowPolicy, length: int, kept: list[bytes]
) -> None:
    outbox = Outbox(1000, 10)
    stream = lane(length, policy)
    for number in range(5):
        outbox.put(stream, b"%d" % number)
    assert stream.dropped == 5 - len(kept)
    assert await drain(outbox) == kept
    assert outbox.waiting_bytes == 0


async def test_what_is_too_old_makes_way_for_what_is_new_but_a_few_are_never_lost() -> None:
    now = 0.0
    outbox = Outbox(1000, 10, clock=lambda: now)
    slow, fast, whole = (Lane(QueuePolicy(100), True, age) for age in (1.0, 1.0, math.inf))
    for number in range(30):
        now = number / 10
        if not number % 10:
            outbox.put(slow, b"s%d" % number)
        outbox.put(fast, b"f%d" % number)
        outbox.put(whole, b"w%d" % number)
    assert [item.dropped for item in (slow, fast, whole)] == [0, 14, 0]
    now = 10.0
    written = await drain(outbox)
    assert written[:3] == [b"s0", b"f14", b"w0"]
    assert [item.dropped for item in (slow, fast, whole)] == [0, 14, 0]
    assert (len(written), outbox.waiting_bytes) == (3 + 16 + 30, 0)


async def test_what_waited_for_a_client_that_was_away_is_as_new_as_its_return() -> None:
    now = 0.0
    outbox = Outbox(1000, 10, clock=lambda: now)
    stream = Lane(QueuePolicy(100), True, 1.0)
    for number in range(30):
        outbox.put(stream, b"%d" % number)
    now = 5.0
    outbox.renew()
    assert len(await drain(outbox)) == 30


async def test_a_fat_stream_does_not_push_out_a_thin_one() -> None:
    outbox = Outbox(1000, 10)
    fat, thin = lane(), lane()
    outbox.put(thin, b"t")
    for _ in range(50):
        outbox.put(fat, bytes(300))
    assert outbox.waiting_bytes <= 1000
    assert thin.dropped == 0
    assert fat.dropped == 47


@pytest.mark.parametrize("messages", [1, 4])
def test_a_message_for_a_slow_client_costs_the_same_beside_few_streams_and_many(
    messages: int,
) -> None:
    """All is done in the loop, which has other clients."""
    spent = []
    for count in (20, 2000):
        outbox = Outbox(count * messages * 10, 10)
        streams = [lane() for _ in range(count)]
        for stream in streams * messages:
            outbox.put(stream, bytes(10))
        outbox.put(streams[0], bytes(10))

        def put(outbox: Outbox = outbox, streams: list[Lane] = streams) -> None:
            for stream in streams[:20] * 10:
                outbox.put(stream, bytes(10))

        spent.append(calls_of(put))
        assert outbox.dropped == 201
        for stream in streams:
            outbox.discard(stream)
        assert outbox.empty
    assert spent[1] < 1.5 * spent[0]


async def test_one_message_larger_than_the_limit_still_goes() -> None:
    outbox = Outbox(1000, 10)
    outbox.put(lane(), bytes(5000))
    assert len(await drain(outbox)) == 1


async def test_one_large_message_does_not_let_the_others_grow() -> None:
    outbox = Outbox(1000, 10)
    outbox.put(lane(), bytes(5000))
    thin = lane()
    for _ in range(100):
        outbox.put(thin, bytes(20))
    assert outbox.waiting_bytes == 5020
    assert thin.dropped == 99


async def test_the_pieces_of_a_last_message_are_not_dropped() -> None:
    outbox = Outbox(1000, 10)
    ending, other = lane(), lane()
    outbox.finish(ending, bytes(400), bytes(500))
    outbox.put(other, bytes(100))
    outbox.put(other, bytes(200))
    assert await drain(outbox) == [bytes(400), bytes(200), bytes(500)]


async def test_too_many_replies_are_not_dropped_but_reported() -> None:
    outbox = Outbox(1000, 10)
    for _ in range(10):
        outbox.reply(b"r", text=True)
    assert not outbox.overflowed
    outbox.reply(b"r", text=True)
    assert outbox.overflowed


async def test_a_killed_stream_leaves_nothing_behind() -> None:
    outbox = Outbox(1000, 10)
    gone, stays = lane(), lane()
    outbox.put(gone, b"g")
    outbox.put(stays, b"s")
    outbox.discard(gone)
    assert await drain(outbox) == [b"s"]


async def test_the_pieces_of_one_message_drop_together() -> None:
    outbox = Outbox(1000, 10)
    pieces, other = lane(1), lane()
    outbox.put(pieces, b"x1", b"x2", b"x3")
    outbox.put(pieces, b"y1", b"y2")
    outbox.put(other, b"o")
    assert await drain(outbox) == [b"y1", b"o", b"y2"]
    assert (pieces.dropped, pieces.sent) == (1, 1)


async def test_small_messages_of_others_pass_between_the_pieces_of_a_large_one() -> None:
    outbox = Outbox(1000, 10)
    large, small, other = lane(), lane(), lane()
    outbox.put(large, b"x1", b"x2", b"x3", b"x4")
    outbox.put(large, b"after")
    assert (await outbox.next())[0][0] == b"x1"
    outbox.put(other, b"y1", b"y2")
    for number in range(2):
        outbox.put(small, b"%d" % number)
    # The next in turn is in pieces itself, and waits; what is behind it waits for its turn.
    assert [(await outbox.next())[0][0] for _ in range(3)] == [b"x2", b"x3", b"x4"]
    assert await drain(outbox) == [b"after", b"y1", b"0", b"y2", b"1"]
    outbox.put(large, b"z1", b"z2", b"z3")
    outbox.put(large, b"after")
    for number in range(3):
        outbox.put(small, b"%d" % number)
    assert await drain(outbox) == [b"z1", b"0", b"z2", b"1", b"z3", b"after", b"2"]
    assert (large.sent, small.sent, other.sent, outbox.waiting_bytes) == (4, 5, 1, 0)


async def test_small_frames_are_taken_together_and_held_until_they_are_written() -> None:
    account = ServerMemory(10_000, 10_000).open()
    outbox = Outbox(1000, 10, account)
    many = lane(10)
    for number in range(4):
        outbox.put(many, b"%d" % number * 10)
    outbox.reply(b"reply", text=True)
    frames = await outbox.next(26)  # the reply, two whole messages, and one that passes it
    assert [frame[:1] for frame, _ in frames] == [b"r", b"0", b"1", b"2"]
    assert (many.sent, account.held) == (3, 45)
    assert [frame[:1] for frame, _ in await outbox.next(26)] == [b"3"]
    assert account.held == 10


async def test_it_is_emptied_once_more_for_what_came_since() -> None:
    outbox = Outbox(1000, 10)
    taken = []

    async def take() -> None:
        while True:
            taken.append((await outbox.next())[0][0])

    taking = asyncio.ensure_future(take())
    for frame in (b"first", b"second"):
        outbox.reply(frame, text=True)
        await outbox.emptied()
        assert taken[-1] == frame
    taking.cancel()


async def test_what_is_added_while_the_writer_waits_is_written_without_it() -> None:
    account = ServerMemory(1000, 1000).open()
    outbox = Outbox(1000, 10, account)
    stream, written = lane(), list[list[bytes]]()
    may_write = True

    def write() -> bool:
        if may_write:
            written.append([frame for frame, _ in outbox.take(1000)])
            outbox.note_written()
        return may_write

    outbox.write_with(write, asyncio.get_running_loop().call_soon)
    outbox.put(stream, b"first")
    await asyncio.sleep(0)
    assert not written, "the writer is not there, or writes"
    assert await outbox.next() == [(b"first", True)]
    writing = asyncio.ensure_future(outbox.next())
    await asyncio.sleep(0)
    assert account.held == 0
    outbox.put(stream, b"a")
    outbox.put(stream, b"b")
    outbox.reply(b"reply", text=True)
    await outbox.emptied()
    assert written == [[b"reply", b"a", b"b"]], "all of a turn, with one write"
    assert account.held == 0
    assert not writing.done()
    may_write = False
    outbox.put(stream, b"c")
    assert await writing == [(b"c", True)], "what cannot be written at once is the writer's"
    writing = asyncio.ensure_future(outbox.next())
    await asyncio.sleep(0)
    outbox.put(stream, b"d")
    outbox.discard(stream)
    assert await writing == [], "it may be a ping, or the socket, that has to be waited for"
    writing = asyncio.ensure_future(outbox.next())
    await asyncio.sleep(0)
    outbox.write_with(None, None)
    outbox.put(stream, b"e")
    assert await writing == [(b"e", True)]
    assert len(written) == 1


async def test_data_waits_for_a_client_that_reads_slowly_and_replies_do_not() -> None:
    now = 0.0
    outbox = Outbox(10_000_000, 10, clock=lambda: now)
    stream = Lane(QueuePolicy(1000), True, 1.0)
    outbox.put(stream, b"first")
    assert outbox.begin_ping() is None  # a client without streams is sent none
    await outbox.next()
    answered = outbox.begin_ping()
    assert answered is not None
    answered()
    for _ in range(20):
        outbox.put(stream, bytes(2**16))
    now = 0.5  # it has kept up until now
    await outbox.next(2**16)
    answered = outbox.begin_ping()
    assert answered is not None
    await outbox.next(2**16)
    now = 1.0
    answered()  # it reads 128 KiB a second
    outbox.put(stream, b"last")
    assert outbox.unread_seconds() == 0
    assert await outbox.next() == []  # the window is full, and a ping is due
    answered = outbox.begin_ping()
    assert answered is not None
    reading = asyncio.ensure_future(outbox.next())
    await asyncio.sleep(0)
    assert not reading.done()
    outbox.reply(b"reply", text=True)
    assert await reading == [(b"reply", True)]
    now = 1.25
    assert outbox.unread_seconds() == 0.25
    reading = asyncio.ensure_future(outbox.next())
    answered()
    assert len((await reading)[0][0]) == 2**16
    assert outbox.unread_seconds() == 0


async def test_what_would_be_too_old_when_it_is_read_makes_way() -> None:
    now = 0.0
    outbox = Outbox(10_000_000, 10, clock=lambda: now)
    stream = Lane(QueuePolicy(1000), True, 1.0)
    for number in range(30):
        outbox.put(stream, b"%d" % number)
    await outbox.next()
    assert outbox.begin_ping() is not None
    now = 0.5
    outbox.put(stream, b"new")
    assert stream.dropped == 0
    now = 0.6
    outbox.put(stream, b"new")
    assert stream.dropped == 15  # all but 16: an answer takes 0.6 s already


steps = st.lists(
    st.tuples(st.sampled_from(["put", "next", "reply", "wait", "renew"]), st.integers(1, 400)),
    max_size=60,
)


@given(steps)
def test_every_message_is_sent_waits_or_is_counted(plan: list[tuple[str, int]]) -> None:
    async def work() -> None:
        now = 0.0
        outbox = Outbox(1000, 1000, clock=lambda: now)
        lanes = [lane(4), lane(1, OverflowPolicy.LATEST), Lane(QueuePolicy(50), True, 3.0)]
        put = [0] * len(lanes)
        for step, number in plan:
            if step == "put":
                chosen = number % len(lanes)
                outbox.put(lanes[chosen], bytes(number if chosen < 2 else 1))
                put[chosen] += 1
            elif step == "wait":
                now += number / 100
            elif step == "renew":
                outbox.renew()
            elif step == "reply":
                outbox.reply(b"r", text=False)
            elif not outbox.empty:
                frames = await outbox.next(number)
                assert sum(len(frame) for frame, _ in frames[:-1]) < number
        for count, item in zip(put, lanes, strict=True):
            assert count == item.sent + item.dropped + len(item.waiting)
        pieces = [frame for item in lanes for _, frames, _ in item.waiting for frame in frames]
        assert sum(map(len, pieces)) <= 1000 or all(len(item.waiting) <= 1 for item in lanes)

    asyncio.run(asyncio.wait_for(work(), patience()))
