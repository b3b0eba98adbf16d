"""How much may be under way to a client that reads more slowly than messages come."""

from __future__ import annotations

import math
from collections import deque

_PING_SECONDS = 0.1
_LOOK_SECONDS = 0.25
_AIM_SECONDS = 0.4
_RATE_SECONDS = 0.3
_KNOWN_SECONDS = 1.0
_SLOW_SECONDS = 5.0
_FOUND_SECONDS = 30.0
_LEAST_OCTETS = 2**16
_PARTS = 4


class SendWindow:
    """Bounds what is under way by the time that it takes, from answers to pings behind it.

    What the kernels of both ends and the network hold, seconds of small messages, can be dropped by
    no client however old it is; what waits for a window can. A ping is answered when the client has
    read all before it, so answers show how fast it reads. The window is what it reads in 0.4 s and
    the quickest round trip, 64 KiB at least, and without a bound where the client keeps up; then
    pings go four times a second at most, and each that has no answer for as long closes it. The
    first ping of a connection, before anything waits, shows how quick a round trip can be.

    A round trip may become slower for good, which looks like a client that does. Where answers were
    slow for five seconds, and twice a minute, nothing goes until all is read, and a ping behind
    nothing shows how quick a round trip can be now.

    It knows no socket and no clock: all times are seconds of one clock, sizes are octets.

    Attributes:
        sent: octets handed to the socket since the beginning; who writes counts them here.
        is_free: whether nothing bounds what goes: no ping is out and no rate is known. Then it is
            never full and nothing is known to be under way, so that who writes need not ask; of
            small messages that would take a good part of the time.
        rests_until: until when it wants no ping while it is free and no messages wait.
    """

    def __init__(self) -> None:
        # True only while there are no pings, no answers and no draining. Each begins with a ping
        # or its answer: `asked` clears it, and it is set again where the last of them goes.
        self.is_free = True
        self.sent = 0  # differences of it are what is under way
        self.rests_until = -math.inf
        # The bound. Infinite while the client keeps up, so that a fast one is never held back.
        self._octets = math.inf
        self._asked: tuple[float, float] = (-math.inf, -math.inf)  # the last ping, and what before
        self._pings: deque[tuple[float, int]] = deque()  # when they were sent, and what before
        self._answers: deque[tuple[float, int]] = deque()  # when they came, and what was read
        self._read = 0
        self._answered_at = -math.inf
        self._took = 0.0
        # The quickest answer: a round trip without waiting. Infinite until the first one.
        self._least = math.inf
        self._behind_at = -math.inf
        self._quick_at = -math.inf
        self._found_at = -math.inf
        # Whether nothing goes until all is read, to measure a round trip behind nothing.
        self._is_draining = False

    def wants_ping(self, now: float, *, is_behind: bool) -> bool:
        """Say whether to send a ping, behind what was written; `is_behind`: messages wait.

        Whenever it is stuck.
        """
        at, before = self._asked
        # An answer that is outstanding for long counts as an answer that came late: a client that
        # stops reading answers nothing, and would pass for one that keeps up.
        if is_behind or self._is_slow(self.waited(now)):
            self._behind_at = now
        elif self._keeps_up(now):
            # Rates of a time in which it did not keep up say nothing of the next one.
            self._answers.clear()
            self._octets = math.inf
            self._is_draining = False
            self.is_free = not self._pings
            is_time = now - at >= _LOOK_SECONDS and self.sent - before >= _LEAST_OCTETS
            if not is_time:  # too little was written: what is small needs not ask each time
                self.rests_until = max(self.rests_until, now + _PING_SECONDS)
            return is_time and not self._pings
        self.is_free = False
        is_time = now - at >= _PING_SECONDS or self.sent - before >= self._octets / _PARTS
        return is_time or self.is_stuck(now)

    def asked(self, now: float) -> None:
        self.is_free = False
        self.rests_until = now + _LOOK_SECONDS
        self._asked = (now, self.sent)
        self._pings.append((now, self.sent))

    def answered(self, now: float) -> None:
        """Note the answer to the oldest ping."""
        if self.is_full(now):
            self._behind_at = now
        # Answers come in the order of pings (RFC 6455, 5.5.3: only the newest may be left out, and
        # the library settles those before it).
        at, read = self._pings.popleft()
        before, self._read = self._read, read
        was_behind_nothing = before == read and at >= self._answered_at
        self._answered_at = now
        self._took = now - at
        # Read before `_least` is set below.
        is_first = self._least == math.inf
        if was_behind_nothing or self._took < self._least:
            self._least, self._found_at, self._is_draining = self._took, now, False
        if not self._is_slow(self._took):
            self._quick_at = now
        if is_first:
            self._behind_at = -math.inf  # it took a round trip, as it has to
        if self._keeps_up(at):
            self.is_free = not (self._pings or self._answers or self._is_draining)
            return
        if was_behind_nothing and self._answers:
            # It goes on as before it was drained, and what is sent now is not there at once.
            self._answers = deque([(now + self._took, read)])
            return
        if not self._answers:
            self._answers.append((at, before))
        self._answers.append((now, read))
        # Two answers always stay: a rate needs both ends.
        while now - self._answers[1][0] >= _RATE_SECONDS + self._least:
            self._answers.popleft()
        since, start = self._answers[0]
        # Not over less than the time between two pings: two answers that came together have no
        # rate.
        rate = (read - start) / max(now - since, _PING_SECONDS)
        self._octets = max(_LEAST_OCTETS, rate * (_AIM_SECONDS + self._least))
        # Only set here, and cleared by an answer behind nothing, which is what draining is for.
        self._is_draining |= (
            now - self._quick_at > _SLOW_SECONDS + 10 * self._least
            or now - self._found_at > _FOUND_SECONDS * (1 + self._least)
        )

    def is_full(self, now: float) -> bool:
        """Say whether nothing more may go until the next answer."""
        if self._is_draining:
            return True
        # Against what the last answer covers: all after that may be unread.
        if self._answers:
            return self.sent - self._answers[-1][1] >= self._octets
        return self._is_slow(self.waited(now))

    def is_stuck(self, now: float) -> bool:
        """Say whether it is full, and a ping has to be sent for an answer to come."""
        return self.is_full(now) and not self._pings

    def waited(self, now: float) -> float:
        """Return for how long the answer to a ping has been outstanding; 0 where none is."""
        return now - self._pings[0][0] if self._pings else 0.0

    def silent(self, now: float) -> float:
        """Return for how long no answer came although a ping was sent; 0 where none is awaited."""
        return now - max(self._pings[0][0], self._answered_at) if self._pings else 0.0

    def transit(self, now: float) -> float:
        """Return how long what is written now is under way at least, as far as known lately."""
        is_known = bool(self._answers) and now - self._answers[-1][0] < _KNOWN_SECONDS + self._least
        return max(self.waited(now), self._took if is_known else 0.0)

    @property
    def _round_trip(self) -> float:
        return 0.0 if self._least == math.inf else self._least

    def _is_slow(self, seconds: float) -> bool:
        """Say whether an answer that takes so long waited for the client to read."""
        return seconds > _AIM_SECONDS + self._round_trip

    def _keeps_up(self, now: float) -> bool:
        """Say whether nothing waited then, and for a while: what is new may just have been sent."""
        return now - self._behind_at > _KNOWN_SECONDS + self._round_trip
