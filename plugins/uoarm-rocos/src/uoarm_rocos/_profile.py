"""A device that speaks the profile: catalogue, calls and flows over one kept line."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from uoarm.bridge import Delivery, Disconnection, HealthReason
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Health
from uoarm_rocos._catalogue import (
    Api,
    CallMessage,
    CloseMessage,
    DataMessage,
    DeviceCatalogue,
    ErrorMessage,
    OpenMessage,
    ResultMessage,
    WireMessage,
    differences,
)
from uoarm_rocos._channels import ProfileFlow, ProfileInput, ProfileOutput, delivery_queue
from uoarm_rocos._conversation import Conversation, LineParts
from uoarm_rocos._device import LineDevice, PendingAnswers, PendingReply, ReportHealth, refusal
from uoarm_rocos._framing import LineError
from uoarm_rocos._health import flow_monitor
from uoarm_rocos._line import DeviceLine
from uoarm_rocos._options import Timing
from uoarm_rocos._structure import fit

__all__ = ["Changed", "ProfileDevice"]

_MOST_UNSAID = 1000
Changed = Callable[[Health, str, "dict[str, str]"], None]


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
        changed: called with the line's health, and APIs that changed, from the line's thread.
    """

    def __init__(
        self,
        name: str,
        wire: LineParts,
        timing: Timing,
        catalogue: DeviceCatalogue | None,
        changed: Changed,
    ) -> None:
        super().__init__()
        self.name = name
        self.is_prompt = wire.prompt
        self._timing = timing
        self._changed = changed
        self._known = catalogue
        self._ready = False
        self._cause = "not connected yet"
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
        self._line.start()

    def catalogue(self, timeout: float) -> DeviceCatalogue:
        """Return what the device offers now."""
        self._await_ready(timeout)
        assert self._known is not None
        return self._known

    def facts(self) -> dict[str, object]:
        """Return counters of the line."""
        return self._conversation.facts()

    def call(self, api: Api, message: object, timeout: float) -> dict[str, Any]:
        """Ask a service; gives the call up, with a word to the device, when time is up."""
        end = time.monotonic() + timeout
        values = fit(api.input, message, f"request to {api.name}")
        self._await_ready(min(timeout, self._timing.wait))
        self._check_same(api)
        what = f"calling {api.name} of {self.name}"
        identity, refused = self._conversation.ids.next(), self._conversation.refused
        answer = self._answers.expect(identity, what)
        is_answered = False
        try:
            self._send_call(lambda seq: CallMessage(seq, identity, api.name, values), answer, end)
            is_answered = answer.wait(max(0.0, end - time.monotonic()))
        except BridgeError:
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
            self._ready = True
            flows = list(self._flows)
            self._state.notify_all()
        self._disconnection.up()
        found = {} if before is None else differences(before, catalogue)
        text = "connected again" if before is not None else "connected"
        cause = f"the device has another catalogue: {'; '.join(found.values())}"
        self._changed(Health.OK, cause if found else text, found)
        for flow in flows:
            self._open_again(flow, found)

    def on_message(self, message: WireMessage) -> None:
        """Take one message of the device; from the line's thread."""
        if isinstance(message, DataMessage):
            flow = self._by_id.get(message.id)
            if flow is not None:
                flow.refused = self._conversation.refused
                flow.take(message.values)
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
            self._ready, self._cause = False, cause
            flows = list(self._flows)
            self._by_id.clear()
        self._unsent_closes.clear()
        self._answers.fail(LineError(f"the line to {self.name} was lost: {cause}"))
        text = f"the line to {self.name} is lost: {cause}"
        health = self._disconnection.down(time.monotonic(), final=False)
        if health is not None:
            self._changed(health, f"{HealthReason.DISCONNECTED.value}: {text}", {})
        for flow in flows:
            flow.id = 0
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

    def _await_ready(self, timeout: float) -> None:
        if self._ready and not self._closed:
            return  # without the lock: it would not hold any longer with it
        with self._state:
            if not self._state.wait_for(lambda: self._ready or self._closed, timeout):
                text = f"{self.name} is not there after {timeout:g} s: {self._cause}"
                raise LineError(text)
            if self._closed:
                raise BridgeError(f"{self.name} is closed", FailureReason.CLOSED)

    def _check_same(self, api: Api) -> None:
        now = self._known.apis.get(api.name) if self._known else None
        if now is api or now == api:
            return
        both = [DeviceCatalogue("", {api.name: item} if item else {}) for item in (api, now)]
        found = differences(*both).get(api.name)
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
        try:
            self._conversation.send(lambda seq: OpenMessage(seq, identity, api, way))
        except BridgeError:
            self._answers.forget(identity)
            raise
        return answer

    def _open(self, flow: ProfileFlow, timeout: float) -> None:
        end = time.monotonic() + timeout
        self._await_ready(min(timeout, self._timing.wait))
        self._check_same(flow.api)
        what = f"opening {flow.direction.value} {flow.api.name} of {self.name}"
        refused = self._conversation.refused
        try:
            answer = self._ask_for(flow, what)
            if not answer.wait(max(0.0, end - time.monotonic())):
                text = f"{what}: no answer within {timeout:g} s"
                raise BridgeTimeoutError(text + self._conversation.refused_since(refused))
            answer.value()
            flow.monitor.connected()
        except BridgeError:
            flow.close()
            raise

    def _open_again(self, flow: ProfileFlow, found: dict[str, str]) -> None:
        if flow.api.name in found:
            flow.monitor.refused(f"after reconnecting, {found[flow.api.name]}", final=True)
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

    def _send_data(self, flow: ProfileFlow, values: dict[str, Any]) -> None:
        identity = flow.id
        if not identity:
            raise LineError(f"{self.name} is not connected: {self._cause}")
        self._conversation.send(lambda seq: DataMessage(seq, identity, values))

    def _end(self, flow: ProfileFlow) -> None:
        with self._state:
            self._flows.discard(flow)
            known = self._by_id.pop(flow.id, None)
        self._answers.forget(flow.id)
        if known is not None:
            self._send_close(flow.id)

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
