"""A device that speaks the profile: catalogue, calls and flows over one kept line.

The conversation is what is said on that line: frames, sequence numbers, heartbeat, and the
catalogue at the start.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from attrs import frozen

from uoarm.bridge import Delivery, Disconnection, HealthReason, on_failure
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError, UoarmError
from uoarm.model import Health
from uoarm_rocos._catalogue import (
    Api,
    CallMessage,
    CatalogueMessage,
    CloseMessage,
    DataMessage,
    DescribeMessage,
    DeviceCatalogue,
    ErrorMessage,
    HeartbeatMessage,
    OpenMessage,
    ResultMessage,
    WireMessage,
    difference,
    differences,
)
from uoarm_rocos._channels import ProfileFlow, ProfileInput, ProfileOutput, delivery_queue
from uoarm_rocos._codec import MessageCodec
from uoarm_rocos._device import LineDevice, PendingAnswers, PendingReply, ReportHealth, refusal
from uoarm_rocos._framing import Framer, LineError, WireError
from uoarm_rocos._health import ConversationIds, HeartbeatWatch, SequenceCheck, flow_monitor
from uoarm_rocos._line import DeviceLine
from uoarm_rocos._options import Timing
from uoarm_rocos._structure import fit, fit_given
from uoarm_rocos._transport import LineTransport

_FIRST_HEARTBEAT = 1.0
_CATALOGUE_SECONDS = 3.0
_WRAP = 2**32


@frozen
class LineParts:
    """The replaceable parts of a line: makers of what carries, frames and codes messages.

    Attributes:
        prompt: whether nothing of them ever waits but `open`, `read` and `write` of the transport,
            which then has `write_now` as well: calls are made in the caller's own thread.
    """

    transport: Callable[[], LineTransport]
    framer: Callable[[], Framer]
    codec: MessageCodec
    prompt: bool = False


class ConversationListener(Protocol):
    """What takes events of a conversation; always in the line's thread."""

    def on_ready(self, catalogue: DeviceCatalogue) -> None:
        """The device is there and offers this."""

    def on_message(self, message: WireMessage) -> None:
        """A message that is neither heartbeat nor catalogue."""

    def on_tick(self, now: float) -> None:
        """Time passes."""

    def on_lost(self, cause: str) -> None:
        """The line is gone, or could not be opened."""


class Conversation:
    """One side of the conversation, begun anew whenever the line is.

    Attributes:
        line: set by the owner before the line starts.
        ids: where ids of conversations come from.
        octets: of the message that the listener is given.
        refused: how many messages of the device could not be read.
    """

    line: DeviceLine

    def __init__(
        self, wire: LineParts, fixed: DeviceCatalogue | None, listener: ConversationListener
    ) -> None:
        self.ids = ConversationIds()
        self._wire = wire
        self._fixed = fixed
        self._listener = listener
        # Guards number, framer and line between the threads that send: messages go out in the order
        # of their numbers, and a number whose message was not sent is given again.
        self._sending = threading.Lock()
        self._seq = 0
        self._began = 0.0
        self._asked = 0
        self._framer = wire.framer()
        self._incoming = SequenceCheck()
        self._watch = HeartbeatWatch(_FIRST_HEARTBEAT, 0.0, 0.0)
        self.refused = self._refused_before = 0
        self._why = ""
        self.octets = 0
        self._lost_before = self._damaged_before = 0

    def send(self, build: Callable[[int], WireMessage], within: float | None = None) -> None:
        """Number and send a message; any thread.

        Args:
            build: makes the message of its number.
            within: seconds to wait at most, over a prompt line; None: as long as the line does.

        Raises:
            LineError: the line is not open.
            MessageError: the message cannot be written; nothing was sent.
            BridgeTimeoutError: the line was busy all the time; nothing was sent.
        """
        end = 0.0 if within is None else time.monotonic() + within
        if not self._sending.acquire(timeout=-1 if within is None else max(0.0, within)):
            raise BridgeTimeoutError(f"{self.line.name} took nothing within {within:g} s")
        try:
            seq = self._seq
            try:
                frame = self._framer.frame(self._wire.codec.write(build(seq)))
            except WireError as error:  # what is sent is wrong, not the device
                raise MessageError(str(error)) from error
            self._seq = (seq + 1) % _WRAP  # before, so that no number is ever there twice
            try:
                if within is None:
                    self.line.send(frame)
                else:
                    self.line.send_within(frame, max(0.0, end - time.monotonic()))
            except BridgeError:
                self._seq = seq
                raise
            self._watch.sent = time.monotonic()
        finally:
            self._sending.release()

    def refused_since(self, count: int) -> str:
        """Say what came since there were so many that could not be read, to end a sentence."""
        more = self.refused - count
        if more <= 0:
            return ""
        came = "a message came" if more == 1 else f"{more:,} messages came"
        return f"; {came} that cannot be read, the last: {self._why}"

    def _came(self) -> str:
        """Say what came instead of what is waited for, to end a sentence."""
        damaged = self._framer.discarded
        return self.refused_since(self._refused_before) + (
            f"; {damaged:,} frames came damaged" if damaged else ""
        )

    def facts(self) -> dict[str, object]:
        """Return counters: messages lost on the way, frames damaged, messages refused."""
        return {
            "lost": self._lost_before + self._incoming.lost,
            "damaged": self._damaged_before + self._framer.discarded,
            "refused": self.refused,
        }

    def connected(self) -> None:
        """Begin anew."""
        now = time.monotonic()
        with self._sending:
            self._seq = 0
            self._damaged_before += self._framer.discarded
            self._framer = self._wire.framer()
            self._lost_before += self._incoming.lost
            self._incoming = SequenceCheck()
            period = self._fixed.heartbeat if self._fixed else _FIRST_HEARTBEAT
            self._watch = HeartbeatWatch(period, now, now)
        self._began = now
        self._refused_before = self.refused
        if self._fixed is not None:
            self._asked = 0
            self.send(HeartbeatMessage)
            self._listener.on_ready(self._fixed)
        else:
            self._asked = self.ids.next()
            self.send(lambda seq: DescribeMessage(seq, self._asked))

    def received(self, data: bytes) -> None:
        """Take octets of the line."""
        framer = self._framer
        for frame in framer.feed(data):
            try:
                message = self._wire.codec.read(frame)
            except WireError as error:
                if not framer.resynchronises:
                    raise
                self.refused += 1
                self._why = str(error)
                continue
            if self._incoming.take(message.seq):
                raise LineError("the device has begun anew")
            self._watch.received_at = time.monotonic()
            if not self._asked:
                self._refused_before = self.refused
            self.octets = len(frame)
            self._take(message)

    def tick(self, now: float) -> None:
        """Keep the heartbeat, and notice that the device has none."""
        silent = self._watch.dead(now)
        if silent:
            text = f"the device said nothing for {silent:.1f} s"
            raise LineError(text + self._came())
        if self._asked and now - self._began > _CATALOGUE_SECONDS:
            text = f"the device sent no catalogue within {_CATALOGUE_SECONDS:g} s"
            raise LineError(text + self._came())
        if self._watch.is_heartbeat_due(now):
            self.send(HeartbeatMessage)
        self._listener.on_tick(now)

    def lost(self, cause: str) -> None:
        """Pass on that the line is gone."""
        self._listener.on_lost(cause)

    def _take(self, message: WireMessage) -> None:
        if isinstance(message, CatalogueMessage):
            if message.id == self._asked:
                self._asked = 0
                self._watch.period = message.catalogue.heartbeat
                self._listener.on_ready(message.catalogue)
        elif isinstance(message, ErrorMessage) and self._asked and message.id == self._asked:
            text = f"the device gives no catalogue: {message.code.value}: {message.text}"
            raise LineError(text)
        elif not isinstance(message, HeartbeatMessage):
            self._listener.on_message(message)


_MOST_UNSAID = 1000
Changed = Callable[[Health, str, "DeviceCatalogue | None"], None]


class ProfileDevice(LineDevice):
    """One device on one line.

    The line's thread reads, checks and answers heartbeats; a second one delivers, so that a
    receiver may call through the same device.

    Attributes:
        is_prompt: whether a call ends in its time whatever the line does.

    Args:
        name: for threads and errors.
        wire: the replaceable parts: transport, framer, codec.
        timing: limits.
        catalogue: what the device offers, where it is not to be asked.
        changed: called with the line's health and cause, and what the device offers now where that
            was asked or stated, from the line's thread.
    """

    def __init__(
        self,
        name: str,
        wire: LineParts,
        timing: Timing,
        catalogue: DeviceCatalogue | None,
        changed: Changed,
    ) -> None:
        super().__init__(name)
        self.is_prompt = wire.prompt
        self._timing = timing
        self._changed = changed
        self._known = catalogue
        self._disconnection = Disconnection(timing.grace)
        self._answers = PendingAnswers(name)
        self._flows: set[ProfileFlow] = set()
        self._by_id: dict[int, ProfileFlow] = {}
        self._unsent_closes: deque[int] = deque(maxlen=_MOST_UNSAID)
        self._deliveries = delivery_queue(name)
        self._conversation = Conversation(wire, catalogue, self)
        self._line = DeviceLine(
            name, wire.transport, self._conversation, timing.backoff, is_shared=wire.prompt
        )
        self._conversation.line = self._line
        with on_failure(self._deliveries.close):  # the system gives no more threads
            self._line.start()

    def catalogue(self, timeout: float) -> DeviceCatalogue:
        """Return what the device offers now."""
        self._await(timeout)
        assert self._known is not None
        return self._known

    def facts(self) -> dict[str, object]:
        """Return counters of the line."""
        return self._conversation.facts()

    def call(self, api: Api, message: object, timeout: float) -> dict[str, Any]:
        """Ask a service; gives the call up, with a word to the device, when time is up."""
        end = time.monotonic() + timeout
        values = fit_given(api.input, message, f"request to {api.name}")
        self._await(min(timeout, self._timing.wait))
        self._check_same(api)
        what = f"calling {api.name} of {self.name}"
        identity, refused = self._conversation.ids.next(), self._conversation.refused
        answer = self._answers.expect(identity, what)
        is_answered = False
        try:
            self._send_call(lambda seq: CallMessage(seq, identity, api.name, values), answer, end)
            is_answered = answer.wait(max(0.0, end - time.monotonic()))
        except UoarmError:
            self._answers.forget(identity)  # nothing was sent
            raise
        finally:  # also where the caller's thread is interrupted
            if not is_answered and self._answers.forget(identity):
                self._send_close(identity, 0.0 if self.is_prompt else None)
        if not is_answered:
            text = f"{what}: no answer within {timeout:g} s; it was given up"
            raise BridgeTimeoutError(text + self._conversation.refused_since(refused))
        return fit(api.output, answer.value(), f"result of {api.name}")

    def open_output(
        self, api: Api, deliver: Delivery, report: ReportHealth, timeout: float
    ) -> ProfileOutput:
        """Open a flow from the device."""
        monitor = flow_monitor(self._named(api), api.period, self._timing.grace, report)
        flow = ProfileOutput(api, monitor, self._end, deliver, self._deliveries)
        self._open(flow, timeout)
        return flow

    def open_input(self, api: Api, report: ReportHealth, timeout: float) -> ProfileInput:
        """Open a flow into the device."""
        monitor = flow_monitor(self._named(api), None, self._timing.grace, report)
        feed = ProfileInput(api, monitor, self._end, self._send_data)
        self._open(feed, timeout)
        return feed

    def _ended(self) -> None:
        self._deliveries.close()
        self._answers.fail(BridgeError(f"{self.name} was closed", FailureReason.CLOSED))

    def on_ready(self, catalogue: DeviceCatalogue) -> None:
        """Begin, or begin again, with what the device offers now; from the line's thread."""
        with self._state:
            before, self._known = self._known, catalogue
            self._is_there = True
            flows = list(self._flows)
            self._state.notify_all()
        self._disconnection.up()
        found = {} if before is None else differences(before, catalogue)
        text = "connected again" if before is not None else "connected"
        cause = f"the device has another catalogue: {'; '.join(found.values())}"
        self._changed(Health.OK, cause if found else text, catalogue)
        for flow in flows:
            self._open_again(flow, catalogue)

    def on_message(self, message: WireMessage) -> None:
        """Take one message of the device; from the line's thread."""
        if isinstance(message, DataMessage):
            flow = self._by_id.get(message.id)
            if flow is not None:
                flow.refused = self._conversation.refused
                flow.take(message.values, self._conversation.octets)
        elif isinstance(message, ResultMessage):
            self._answers.give(message.id, message.values)
        elif isinstance(message, OpenMessage):
            again = self._by_id.get(message.id)
            if not self._answers.give(message.id, None) and again is not None:
                again.monitor.connected()
        elif isinstance(message, ErrorMessage):
            self._take_error(message)
        elif isinstance(message, CloseMessage):
            flow = self._by_id.pop(message.id, None)
            if flow is not None:
                flow.monitor.peer_reported(Health.FINISHED, "the device ended the flow")

    def on_lost(self, cause: str) -> None:
        """Fail what waits and report it to flows; from the line's thread, at each attempt."""
        with self._state:
            self._is_there, self._cause = False, cause
            flows = list(self._flows)
            for flow in flows:
                flow.id = 0
            self._by_id.clear()
        self._unsent_closes.clear()
        self._answers.fail(LineError(f"the line to {self.name} was lost: {cause}"))
        text = f"the line to {self.name} is lost: {cause}"
        health = self._disconnection.down(time.monotonic(), final=False)
        if health is not None:
            self._changed(health, f"{HealthReason.DISCONNECTED.value}: {text}", None)
        for flow in flows:
            flow.monitor.connected(0, text)
            flow.monitor.tick()

    def on_tick(self, now: float) -> None:
        """Look at the clock; from the line's thread."""
        del now  # a flow has the same clock
        while self._unsent_closes:
            self._send_close(self._unsent_closes.popleft())
        for flow in list(self._by_id.values()):
            flow.monitor.tick(self._conversation.refused_since(flow.refused))

    def _named(self, api: Api) -> str:
        return f"flow {api.name} of {self.name}"

    def _check_same(self, api: Api) -> None:
        found = difference(api, self._known) if self._known is not None else ""
        if found:
            text = f"{self.name} has another catalogue than the one that was checked: {found}"
            raise BridgeError(text, FailureReason.CONTRACT)

    def _send_call(
        self, build: Callable[[int], WireMessage], answer: PendingReply, end: float
    ) -> None:
        """Send a question; over a prompt line read the answer as well, if no other thread reads."""
        if not self.is_prompt:
            self._conversation.send(build)
        elif not self._send_in_turn(build, answer, end):
            self._conversation.send(build, end - time.monotonic())

    def _send_in_turn(
        self, build: Callable[[int], WireMessage], answer: PendingReply, end: float
    ) -> bool:
        """Send a question and read the answer, where no other thread reads or sends just now."""
        if not self._line.begin_turn():
            return False
        try:
            # Waiting for another sender would keep all callers from reading.
            self._conversation.send(build, 0.0)
        except BridgeTimeoutError:
            return False
        else:
            self._line.read_for(answer.is_given, end)
            return True
        finally:
            self._line.end_turn()

    def _ask_for(self, flow: ProfileFlow, what: str) -> PendingReply:
        identity = self._conversation.ids.next()
        answer = self._answers.expect(identity, what)
        with self._state:
            self._flows.add(flow)
            self._by_id[identity], flow.id = flow, identity
            flow.refused = self._conversation.refused
        api, way = flow.api.name, flow.direction
        with on_failure(self._answers.forget, identity):
            self._conversation.send(lambda seq: OpenMessage(seq, identity, api, way))
        return answer

    def _open(self, flow: ProfileFlow, timeout: float) -> None:
        end = time.monotonic() + timeout
        self._await(min(timeout, self._timing.wait))
        self._check_same(flow.api)
        what = f"opening {flow.direction.value} {flow.api.name} of {self.name}"
        refused = self._conversation.refused
        with on_failure(flow.close):
            answer = self._ask_for(flow, what)
            if not answer.wait(max(0.0, end - time.monotonic())):
                text = f"{what}: no answer within {timeout:g} s"
                raise BridgeTimeoutError(text + self._conversation.refused_since(refused))
            answer.value()
            flow.monitor.connected()

    def _open_again(self, flow: ProfileFlow, catalogue: DeviceCatalogue) -> None:
        if found := difference(flow.api, catalogue):
            flow.monitor.refused(f"after reconnecting, {found}", final=True)
            return
        with self._state:
            if flow not in self._flows or self._by_id.get(flow.id) is flow:
                return  # closed, or opened by its user since the line came back
            identity = self._conversation.ids.next()
            self._by_id[identity], flow.id = flow, identity
            flow.refused = self._conversation.refused
        self._conversation.send(
            lambda seq: OpenMessage(seq, identity, flow.api.name, flow.direction)
        )
        if flow not in self._flows:  # closed meanwhile, which may have been sent before
            self._send_close(identity)

    def _send_data(self, flow: ProfileFlow, values: dict[str, Any]) -> None:
        identity = flow.id
        if not identity:
            raise LineError(f"{self.name} is not connected: {self._cause}")
        self._conversation.send(lambda seq: DataMessage(seq, identity, values))

    def _end(self, flow: ProfileFlow) -> None:
        with self._state:
            self._flows.discard(flow)
            identity = flow.id  # the line's thread may have another, or 0, at any time after this
            known = self._by_id.pop(identity, None)
        self._answers.forget(identity)
        if known is not None:
            self._send_close(identity)

    def _send_close(self, identity: int, within: float | None = None) -> None:
        try:
            self._conversation.send(lambda seq: CloseMessage(seq, identity), within)
        except BridgeTimeoutError:
            self._unsent_closes.append(identity)  # the line's thread says it
        except BridgeError:
            return  # the line is gone, and every conversation with it

    def _take_error(self, message: ErrorMessage) -> None:
        if message.id == 0:
            raise refusal(message, self.name)
        flow = self._by_id.pop(message.id, None)
        if not self._answers.refuse(message) and flow is not None:
            flow.monitor.refused(str(refusal(message, f"the flow {flow.api.name}")), final=True)
