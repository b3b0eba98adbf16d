"""What the bridge asks of a device, whatever it speaks: the profile, its own frames, a voice."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from uoarm.bridge import Delivery, wait_step
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health
from uoarm_rocos._catalogue import Api, ApiKind, DeviceCatalogue, Direction, ErrorCode, ErrorMessage
from uoarm_rocos._framing import LineError
from uoarm_rocos._line import DeviceLine

ReportHealth = Callable[[Health, str], None]


class DeviceFlow(Protocol):
    """An open flow from a device."""

    def facts(self) -> Mapping[str, object]:
        """Return counters for the status; quick."""

    def close(self) -> None:
        """End the flow; does not wait for a delivery under way, begins no other."""


class InputFlow(DeviceFlow, Protocol):
    """An open flow into a device."""

    def send(self, message: object) -> None:
        """Hand over one message; blocks as long as the line does, which is bounded.

        Raises:
            MessageError: it does not fit, or is longer than the line takes.
            BridgeError: the line is gone.
        """


class Device(ABC):
    """One device that a bridge instance uses.

    Must implement: `catalogue`, `stop`, `close`. May implement what its catalogue offers.

    Attributes:
        is_prompt: whether `call` ends in its time whatever the device does.
        empty_turns: how often its thread looked for octets before its time, and found none.
    """

    is_prompt = False
    empty_turns: int = 0

    @abstractmethod
    def catalogue(self, timeout: float) -> DeviceCatalogue:
        """Return what the device offers now, waiting so many seconds for it to be there.

        Raises:
            BridgeError: UNAVAILABLE with the cause.
        """

    def open_output(
        self, api: Api, deliver: Delivery, report: ReportHealth, timeout: float
    ) -> DeviceFlow:
        """Open a flow from the device; it is open when this returns.

        Raises:
            BridgeError: the device refused or is gone.
        """
        raise NotImplementedError

    def open_input(self, api: Api, report: ReportHealth, timeout: float) -> InputFlow:
        """Open a flow into the device; it is open when this returns.

        Raises:
            BridgeError: the device refused or is gone.
        """
        raise NotImplementedError

    def call(self, api: Api, message: object, timeout: float) -> dict[str, Any]:
        """Ask a service and wait for its answer at most `timeout` seconds.

        Raises:
            MessageError: the request does not fit, or is longer than the line takes.
            BridgeTimeoutError: no answer; the call was given up.
            BridgeError: the device refused, failed, or is gone.
        """
        raise NotImplementedError

    @abstractmethod
    def stop(self) -> None:
        """Begin to let go; returns at once, and `close` comes next."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the device; bounded, once."""


class LineDevice(Device):
    """A device on a line of its own, which its constructor opens as the last thing.

    Args:
        name: for threads and errors.

    Must implement: `catalogue`. May implement `_ended`.
    """

    _line: DeviceLine

    def __init__(self, name: str) -> None:
        self.name = name
        # Guards what follows, and what a subclass has on its line, between callers and the line's
        # thread; wakes callers that wait for the device.
        self._state = threading.Condition()
        self._is_there = self._closed = False
        self._cause = "not connected yet"  # why it is not there

    @property
    def empty_turns(self) -> int:  # type: ignore[override]  # of no other device
        """How often the line's thread looked for octets before its time, and found none."""
        return self._line.empty_turns

    def stop(self) -> None:
        """Have the line end."""
        self._line.stop()

    def close(self) -> None:
        """Let go of the line; what waits fails."""
        with self._state:
            self._closed = True
            self._state.notify_all()
        self._line.close()
        self._ended()

    def _ended(self) -> None:
        """Have what waits for the device fail: its line has ended."""

    def _await(self, timeout: float) -> None:
        """Wait until the device is there.

        Raises:
            LineError: it is not in so many seconds; the text says why.
            BridgeError: it was closed.
        """
        if self._is_there and not self._closed:
            return  # without the lock: it would not hold any longer with it
        with self._state:
            end = time.monotonic() + timeout
            while not self._is_there and not self._closed:
                if (left := end - time.monotonic()) <= 0:
                    text = f"{self.name} is not there after {round(timeout, 1):g} s"
                    raise LineError(f"{text}: {self._cause}")
                self._state.wait(wait_step(left))
            self._check_open()

    def _check_open(self) -> None:
        if self._closed:
            raise BridgeError(f"{self.name} is closed", FailureReason.CLOSED)


def find(catalogue: DeviceCatalogue, name: str, direction: Direction | None) -> Api:
    """Return an API that is a service (None), or a flow of this direction.

    Raises:
        BridgeError: NOT_FOUND, or BAD_ENDPOINT when it is used in the wrong way.
    """
    api = catalogue.apis.get(name)
    if api is None:
        known = ", ".join(catalogue.apis) or "none"
        text = f"device {catalogue.device!r} has no API {name!r}; it has {known}"
        raise BridgeError(text, FailureReason.NOT_FOUND)
    if direction is None:
        if api.kind is ApiKind.FLOW:
            text = f"API {name!r} is a flow: use it as an output or input, not as a service"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return api
    if api.kind is ApiKind.SERVICE:
        text = f"API {name!r} is a service: it has no {direction.value}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    if not (api.output if direction is Direction.OUTPUT else api.input):
        text = f"the flow {name!r} has no {direction.value}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    return api


_MOST = 1000
_REASONS = {
    ErrorCode.PROFILE: FailureReason.UNSUPPORTED,
    ErrorCode.UNKNOWN_API: FailureReason.NOT_FOUND,
    ErrorCode.BAD_INPUT: FailureReason.BAD_MESSAGE,
    ErrorCode.BUSY: FailureReason.REFUSED,
    ErrorCode.CANCELLED: FailureReason.REFUSED,
    ErrorCode.FAILED: FailureReason.RAISED,
    ErrorCode.LIMIT: FailureReason.BAD_MESSAGE,
}


class PendingReply:
    """Waited for by one thread, given once by another."""

    def __init__(self) -> None:
        # Held until the answer is given: acquiring it waits. Value and error are set before.
        self._given = threading.Lock()
        self._given.acquire()
        self._value: Any = None
        self._error: BridgeError | None = None

    def give(self, value: Any) -> None:
        """Answer."""
        self._value = value
        self._given.release()

    def fail(self, error: BridgeError) -> None:
        """Answer that there is none."""
        self._error = error
        self._given.release()

    def is_given(self) -> bool:
        """Say whether there is an answer, or an error in its place."""
        return not self._given.locked()

    def wait(self, timeout: float) -> bool:
        """Wait so many seconds, once; return whether there is an answer."""
        end = time.monotonic() + timeout
        while not self._given.acquire(timeout=wait_step(max(0.0, end - time.monotonic()))):
            if time.monotonic() >= end:
                return False
        return True

    def value(self) -> Any:
        """Return the answer that was given.

        Raises:
            BridgeError: there is none; the text says why.
        """
        if self._error is not None:
            raise self._error
        return self._value


class PendingAnswers:
    """What one device is asked now, by the id of the conversation; any thread.

    Args:
        name: of the device, for errors.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        # Guards `_waiting` between callers and the line's thread: each answer is given once, by
        # whichever takes it out.
        self._lock = threading.Lock()
        self._waiting: dict[int, tuple[PendingReply, str]] = {}

    def expect(self, identity: int, what: str) -> PendingReply:
        """Wait for an answer from now on; `what` is asked.

        Raises:
            BridgeError: too many wait already.
        """
        answer = PendingReply()
        with self._lock:
            if len(self._waiting) >= _MOST:
                text = f"{what}: {_MOST} questions already wait for {self._name}"
                raise BridgeError(text, FailureReason.REFUSED)
            self._waiting[identity] = (answer, what)
        return answer

    def forget(self, identity: int) -> bool:
        """Wait no longer; return whether a caller did."""
        with self._lock:
            return self._waiting.pop(identity, None) is not None

    def give(self, identity: int, value: Any) -> bool:
        """Answer; return whether a caller waited."""
        with self._lock:
            found = self._waiting.pop(identity, None)
        if found is not None:
            found[0].give(value)
        return found is not None

    def refuse(self, message: ErrorMessage) -> bool:
        """Answer with the device's error; return whether a caller waited."""
        with self._lock:
            found = self._waiting.pop(message.id, None)
        if found is not None:
            found[0].fail(refusal(message, found[1]))
        return found is not None

    def fail(self, error: BridgeError) -> None:
        """Answer everything with an error."""
        with self._lock:
            waiting, self._waiting = list(self._waiting.values()), {}
        for answer, _ in waiting:
            answer.fail(error)


def refusal(message: ErrorMessage, what: str) -> BridgeError:
    """Return the error that a device's `error` message is."""
    text = f"{what}: the device says {message.code.value}: {message.text or 'no reason given'}"
    return BridgeError(text, _REASONS[message.code])
