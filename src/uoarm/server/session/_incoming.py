"""Messages of one connection as they arrive: counted from the first octet, unpacked in turns."""

from __future__ import annotations

import asyncio
import dataclasses
import heapq
import itertools
import mmap
import time
import zlib
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from websockets.exceptions import ProtocolError
from websockets.extensions.base import Extension
from websockets.extensions.permessage_deflate import (
    PerMessageDeflate,
    ServerPerMessageDeflateFactory,
)
from websockets.frames import CTRL_OPCODES, CloseCode, Frame, Opcode
from websockets.typing import ExtensionParameter

from uoarm._support.workers import WorkerExecutor
from uoarm.server._limits import Limits

if TYPE_CHECKING:
    from websockets.typing import BytesLike  # not in the oldest version

_MESSAGES = 4
"""Whole messages that wait for the session: with more nothing is read."""
_PORTION = 2**16
"""Octets unpacked in one go: a tenth of a millisecond."""
_SMALLEST_PILE, _LARGE_PILE = 2**12, 2**20
_ALL_SECONDS = 0.001
# The processor's time: a client is not charged for what else the machine did while it was served.
# Where it counts in steps of 16 ms, as on Windows, the time of day has to do.
_FINE_SECONDS = 0.0001
_now = (
    time.thread_time
    if time.get_clock_info("thread_time").resolution <= _FINE_SECONDS
    else time.perf_counter
)
_OPENING_SECONDS = 0.001
"""What a handshake takes of the loop, most of it beside what is parsed."""
_MANY_HOSTS = 1024
_RATIO = 64
_ALWAYS_UNPACKED = 2**20
"""What any message may become: a longer one `_RATIO` times as long as it is compressed, no more."""
_TRAILER = b"\x00\x00\xff\xff"  # RFC 7692, 7.2.2


@dataclasses.dataclass
class _PackedFrame(Frame):
    """A data frame of a compressed message, as it came.

    Attributes:
        bits: of the window, by which it is unpacked.
    """

    bits: int = 15


class _Unpacking(PerMessageDeflate):
    """The extension, but for what it does to a frame that comes, which `IncomingFrames` does.

    The library unpacks while it parses: 15 KB became 16 MB in one go, and no client was served.
    """

    _is_packed = False

    def decode(self, frame: Frame, *, max_size: int | None = None) -> Frame:
        del max_size  # of what it is compressed, which the library has compared
        if frame.opcode in CTRL_OPCODES:
            return frame
        if frame.opcode is not Opcode.CONT:
            self._is_packed = frame.rsv1
        elif frame.rsv1:
            raise ProtocolError("RSV1 bit set in continuation frame")
        if not self._is_packed:
            return frame
        more = frame.rsv2, frame.rsv3
        bits = self.remote_max_window_bits
        return _PackedFrame(frame.opcode, frame.data, frame.fin, False, *more, bits)


class _UnpackingFactory(ServerPerMessageDeflateFactory):
    def process_request_params(
        self, params: Sequence[ExtensionParameter], accepted_extensions: Sequence[Extension]
    ) -> tuple[list[ExtensionParameter], PerMessageDeflate]:
        answer, made = super().process_request_params(params, accepted_extensions)
        return list(answer), _Unpacking(
            made.remote_no_context_takeover,
            made.local_no_context_takeover,
            made.remote_max_window_bits,
            made.local_max_window_bits,
        )


DEFLATE = _UnpackingFactory(server_no_context_takeover=True, client_no_context_takeover=True)
"""The extension permessage-deflate (RFC 7692), with nothing kept from one message to the next."""


class Turn:
    """The part that one connection has in the loop's time. For `ParsingTurns`.

    Args:
        work: parses and unpacks for a moment; returns whether there is more to do.
    """

    def __init__(self, work: Callable[[], bool]) -> None:
        self.work = work
        self.used = 0.0  # virtual seconds
        self.cost = (
            _OPENING_SECONDS  # of its work, as it was of late: of a newcomer's it is not known
        )
        self.is_waiting = False


class ParsingTurns:
    """Shares the loop's time between connections that have something to parse or to unpack.

    All together have a millisecond of each of the loop's turns. The client that will
    have had least goes first (fair queueing by virtual finish): one small message waits for no
    other's flood, however many flood, and a client that was idle for long has saved up nothing.

    A handshake counts as a millisecond, of its connection and of its address: a client that is
    connected goes before a burst of new ones, and of these each address has its part.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, float, Turn]] = []
        self._numbers = itertools.count()
        self._used = 0.0  # virtual seconds, of the client that was served last when it began
        self._spent = 0.0  # of this turn of the loop
        self._is_scheduled = False
        self._hosts: dict[str, float] = {}  # when handshakes of an address are due, virtual seconds

    async def open(self, turn: Turn, host: str) -> None:
        """Wait until a connection from an address may finish its handshake."""
        may_go_on = asyncio.get_running_loop().create_future()

        def go_on() -> bool:
            if not may_go_on.done():  # it has not been given up
                may_go_on.set_result(None)
                self._spent += _OPENING_SECONDS
            return False

        if len(self._hosts) > _MANY_HOSTS:
            self._hosts = {name: due for name, due in self._hosts.items() if due > self._used}
        due = max(self._used, self._hosts.get(host, 0.0))
        turn.used = self._hosts[host] = due + _OPENING_SECONDS
        opening = Turn(go_on)
        opening.used = due
        self.ask(opening)
        await may_go_on

    def do(self, action: Callable[[], object]) -> None:
        """Have something done when it is its turn; it counts as a millisecond.

        For what the system takes a while for, of many at once: to have back 16 MB, or a socket.
        """

        def work() -> bool:
            action()
            self._spent += _OPENING_SECONDS
            return False

        self.ask(Turn(work))

    def ask(self, turn: Turn) -> None:
        """Have the work of a turn done, now or soon; again while there is more. Idempotent."""
        if turn.is_waiting:
            return
        due = max(turn.used, self._used)
        if self._waiting or self._spent >= _ALL_SECONDS:
            self._put(turn, due)
        else:
            self._serve(turn, due)
        if not self._is_scheduled:
            self._is_scheduled = True
            asyncio.get_running_loop().call_soon(self._serve_more)

    def _serve_more(self) -> None:
        self._spent = 0.0
        while self._waiting and self._spent < _ALL_SECONDS:
            _, _, due, turn = heapq.heappop(self._waiting)
            turn.is_waiting = False
            self._serve(turn, due)
        self._is_scheduled = bool(self._waiting)
        if self._is_scheduled:
            asyncio.get_running_loop().call_soon(self._serve_more)

    def _serve(self, turn: Turn, due: float) -> None:
        self._used = max(self._used, due)
        begun = _now()
        has_more = turn.work()
        used = _now() - begun
        self._spent += used
        turn.used = due + used
        turn.cost = (turn.cost + used) / 2
        if has_more:
            self._put(turn, turn.used)

    def _put(self, turn: Turn, due: float) -> None:
        turn.is_waiting = True
        heapq.heappush(self._waiting, (due + turn.cost, next(self._numbers), due, turn))


class IncomingError(Exception):
    """What came is no message that may come; `code` is that of the close frame."""

    def __init__(self, code: CloseCode, text: str) -> None:
        super().__init__(text)
        self.code = code


class _PartialMessage:
    """The octets of a message that is not whole, whatever they come as: a million pieces are none.

    From a megabyte on in memory of its own, which the system has back at once: of what the
    allocator had, hundreds of megabytes stayed with the process after those who left them had gone.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        self._room: bytearray | mmap.mmap = bytearray()
        self._length = 0

    def __len__(self) -> int:
        return self._length

    def add(self, piece: BytesLike) -> None:
        begin, end = self._length, self._length + len(piece)
        if end > len(self._room):
            octets = max(end, 2 * len(self._room), _SMALLEST_PILE)
            before = self._room
            self._room = mmap.mmap(-1, octets) if octets >= _LARGE_PILE else bytearray(octets)
            self._room[:begin] = before[:begin]
        self._room[begin:end] = bytes(piece)
        self._length = end

    def take(self) -> bytes:
        """Return all, and be empty."""
        taken = bytes(self._room[: self._length])
        self.clear()
        return taken


class IncomingFrames:
    """Makes messages of frames, without I/O.

    A fragment leaves nothing but its content, so that a million empty ones take no memory.

    Args:
        most: octets of one message.
        later: does something in time.

    Attributes:
        octets: held in frames, in the unfinished message and in whole ones.
        is_within_message: whether a message has begun whose last frame has not come.
    """

    def __init__(
        self, most: int, later: Callable[[Callable[[], object]], object] = lambda action: action()
    ) -> None:
        self._most = most
        self._later = later
        self._pile = _PartialMessage()
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._frames: deque[Frame] = deque()
        self._drop_pile()
        self._compressed = 0  # octets that these came as
        self._is_text = False
        self._unpacker: Any = None  # its type has no public name
        self._packed: memoryview | None = None  # what is left of the first frame, once begun
        self._ready: deque[tuple[BytesLike, bool]] = deque()
        self._ready_octets = 0
        self.octets = 0
        self.is_within_message = False

    @property
    def is_full(self) -> bool:
        """Whether so much waits, for the session or to be unpacked, that no more is to be added."""
        return self.is_packed or len(self._ready) > _MESSAGES or self._ready_octets > self._most

    @property
    def is_ready(self) -> bool:
        return bool(self._ready)

    @property
    def is_packed(self) -> bool:
        """Whether something waits to be unpacked."""
        return bool(self._frames)

    def add(self, frame: Frame) -> None:
        """Take a data frame; raises as `unpack`."""
        self.octets += len(frame.data)
        self.is_within_message = not frame.fin
        if self._frames or isinstance(frame, _PackedFrame):
            self._frames.append(frame)
        else:
            self._add_plain(frame)

    def unpack(self) -> None:
        """Unpack a portion of what waits.

        Raises:
            IncomingError: a message is longer than it may be, or compressed wrongly.
        """
        if not self._unpack_portion(self._frames[0]):
            self._frames.popleft()
        while self._frames and not isinstance(self._frames[0], _PackedFrame):
            self._add_plain(self._frames.popleft())

    def take(self) -> tuple[BytesLike, bool] | None:
        """Return the next message, and whether it is text; None: there is no whole one."""
        if not self._ready:
            return None
        content, is_text = self._ready.popleft()
        self._ready_octets -= len(content)
        self.octets -= len(content)
        return content, is_text

    def drop_unfinished(self) -> None:
        """Forget the message whose end will not come; what is whole can be taken still."""
        if not self._frames:  # what is packed is unpacked still, and may be whole
            self.octets -= len(self._pile)
            self._drop_pile()

    def _drop_pile(self) -> None:
        pile, self._pile = self._pile, _PartialMessage()
        if len(pile) >= _LARGE_PILE:
            self._later(pile.clear)

    def _add_plain(self, frame: Frame) -> None:
        if frame.opcode is not Opcode.CONT:
            self._is_text = frame.opcode is Opcode.TEXT
            if frame.fin:
                self._finish(frame.data)  # without a copy
                return
        self._pile.add(frame.data)
        if frame.fin:
            self._finish(self._pile.take())

    def _finish(self, content: BytesLike) -> None:
        self._ready.append((content, self._is_text))
        self._ready_octets += len(content)
        self._compressed = 0

    def _unpack_portion(self, frame: Frame) -> bool:
        """Unpack a portion of a frame; returns whether it has more."""
        assert isinstance(frame, _PackedFrame), "others do not wait"
        if self._packed is None:
            self._packed = memoryview(bytes(frame.data) + _TRAILER if frame.fin else frame.data)
            self._compressed += len(frame.data)
            if frame.opcode is not Opcode.CONT:
                self._is_text = frame.opcode is Opcode.TEXT
                self._unpacker = zlib.decompressobj(wbits=-frame.bits)
        packed = self._packed[:_PORTION]
        room = min(self._most, max(_ALWAYS_UNPACKED, _RATIO * self._compressed)) - len(self._pile)
        most = min(_PORTION, room + 1)
        try:
            portion = b"" if self._unpacker.eof else self._unpacker.decompress(packed, most)
        except zlib.error as error:
            raise IncomingError(CloseCode.PROTOCOL_ERROR, "decompression failed") from error
        self.octets += len(portion)
        self._pile.add(portion)
        if len(portion) > room:
            raise IncomingError(
                CloseCode.MESSAGE_TOO_BIG,
                f"unpacked, a message is longer than {self._most:,} octets"
                if len(self._pile) > self._most
                else f"a message is more than {_RATIO} times as long when it is unpacked",
            )
        self._packed = self._packed[len(packed) - len(self._unpacker.unconsumed_tail) :]
        if not self._unpacker.eof and (self._packed or len(portion) == most):
            return True
        self._packed = None
        self.octets -= len(frame.data)
        if frame.fin:
            self._finish(self._pile.take())
        return False


T = TypeVar("T")
# Decoding costs at most some 0.3 us for each octet, so 2 ms for a frame of this length.
_QUICK_OCTETS = 8192


class RateLimiter:
    """Says how long to wait before a client is read on: a token bucket for each rate, no clock.

    A bucket holds one second's worth. A message is always taken, and may overdraw a bucket by
    whatever it costs: the wait after it makes up for that.

    Args:
        limits: the rates.
        now: seconds.
    """

    def __init__(self, limits: Limits, now: float) -> None:
        self._rates = (
            limits.messages_per_second,
            limits.octets_per_second,
            limits.elements_per_second,
        )
        self._left = list(self._rates)
        self._at = now

    def spend(self, now: float, *, octets: int, elements: int) -> float:
        """Count one message; returns the seconds to wait before the next is read, mostly 0."""
        passed, self._at = max(0.0, now - self._at), now
        wait = 0.0
        for place, cost in enumerate((1, octets, elements)):
            rate = self._rates[place]
            left = min(rate, self._left[place] + passed * rate) - cost
            self._left[place] = left
            if left < 0:
                wait = max(wait, -left / rate)
        return wait


class FrameDecoder:
    """Runs decoding in the loop where it is quick, and otherwise in the one thread of all clients.

    One thread, because decoders hold the interpreter's lock: two would only take memory for two
    messages at a time. A client is not read on meanwhile, so each has one place in the queue.
    """

    def __init__(self) -> None:
        self._thread = WorkerExecutor("uoarm-decode", 1)

    async def run(self, octets: int, decode: Callable[[], T]) -> T:
        """Return the result of `decode`, which takes time in proportion to `octets`."""
        if octets <= _QUICK_OCTETS:
            return decode()
        return await asyncio.get_running_loop().run_in_executor(self._thread, decode)

    def close(self) -> None:
        """Begin with nothing more; does not wait for what is under way."""
        self._thread.shutdown(wait=False, cancel_futures=True)
