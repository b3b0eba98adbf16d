"""The device's side of the profile, without any I/O: catalogue, calls and flows."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from attrs import define

from uoarm_rocos._catalogue import (
    PROFILE,
    Api,
    ApiKind,
    CallMessage,
    CatalogueMessage,
    CloseMessage,
    DataMessage,
    DescribeMessage,
    DeviceCatalogue,
    Direction,
    ErrorCode,
    ErrorMessage,
    HeartbeatMessage,
    OpenMessage,
    ResultMessage,
    WireMessage,
)
from uoarm_rocos._catalogue_xml import load_catalogue
from uoarm_rocos._codec import XmlCodec
from uoarm_rocos._framing import Framer, WireError
from uoarm_rocos._structure import fit

_MOST_CONVERSATIONS = 64
_WRAP = 2**32
Values: TypeAlias = "dict[str, Any]"
Job: TypeAlias = Callable[[float], "Values | None"]
"""Asked again and again with the time; returns the result when there is one."""


class Model(Protocol):
    """What the device is and does."""

    @property
    def catalogue(self) -> DeviceCatalogue:
        """What it offers."""

    def call(self, api: str, values: Values, now: float) -> Values | Job:
        """Answer a service at once, or with a job.

        Raises:
            ValueError: it cannot be done; the text goes to the host.
        """

    def sample(self, api: str, now: float) -> Values | None:
        """Return the next message of a flow with a period, or None when the flow has ended."""

    def events(self, now: float) -> list[tuple[str, Values]]:
        """Return messages of flows without a period, each with its API."""

    def take(self, api: str, values: Values, now: float) -> None:
        """Take a message of a flow from the host."""


@define
class _OpenFlow:
    api: Api
    direction: Direction
    due: float


class ProfileServer:
    """Speaks the profile for a model, to one host at a time."""

    def __init__(self, model: Model, framer: Callable[[], Framer]) -> None:
        self._model = model
        self._make_framer = framer
        self._codec = XmlCodec()
        self._seq = 0
        self.begin(0.0)

    def begin(self, now: float) -> None:
        """Forget the host before; on TCP a new line counts anew."""
        self._framer = self._make_framer()
        if not self._framer.resynchronises:
            self._seq = 0
        self._sent = now
        self._flows: dict[int, _OpenFlow] = {}
        self._jobs: dict[int, tuple[Api, Job]] = {}

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take octets of the host; return frames to send.

        Raises:
            WireError: over TCP, a message that is none.
        """
        frames = []
        for part in self._framer.feed(data):
            try:
                message = self._codec.read(part)
            except WireError:
                if not self._framer.resynchronises:
                    raise
                continue
            if message.seq == 0:
                self._flows, self._jobs = {}, {}
            frames += [self._frame(build, now) for build in self._answer(message, now)]
        return frames

    def step(self, now: float) -> list[bytes]:
        """Return results that are ready, data that are due, and the heartbeat."""
        frames = []
        for identity, (api, job) in list(self._jobs.items()):
            values = job(now)
            if values is not None:
                del self._jobs[identity]
                frames.append(self._frame(_result(identity, api, values), now))
        for identity, flow in list(self._flows.items()):
            period = flow.api.period
            while period and flow.direction is Direction.OUTPUT and flow.due <= now:
                flow.due += period
                sample = self._model.sample(flow.api.name, now)
                if sample is None:
                    del self._flows[identity]
                    frames.append(self._frame(_closing(identity), now))
                    break
                frames.append(self._frame(_data(identity, flow.api, sample, now), now))
        frames += [self._frame(build, now) for build in self._events(now)]
        if now - self._sent >= self._model.catalogue.heartbeat:
            frames.append(self._frame(HeartbeatMessage, now))
        return frames

    def _events(self, now: float) -> list[Callable[[int], WireMessage]]:
        return [
            _data(identity, flow.api, values, now)
            for name, values in self._model.events(now)
            for identity, flow in self._flows.items()
            if flow.api.name == name and flow.direction is Direction.OUTPUT
        ]

    def _frame(self, build: Callable[[int], WireMessage], now: float) -> bytes:
        frame = self._framer.frame(self._codec.write(build(self._seq)))
        self._seq = (self._seq + 1) % _WRAP
        self._sent = now
        return frame

    def _answer(self, message: WireMessage, now: float) -> list[Callable[[int], WireMessage]]:
        if isinstance(message, DescribeMessage):
            if message.profile != PROFILE:
                return [_error(message.id, ErrorCode.PROFILE, f"this device speaks {PROFILE}")]
            identity, catalogue = message.id, self._model.catalogue
            return [lambda seq: CatalogueMessage(seq, identity, catalogue)]
        if isinstance(message, CallMessage):
            return self._call(message, now)
        if isinstance(message, OpenMessage):
            return self._open(message, now)
        if isinstance(message, DataMessage):
            return self._take(message, now)
        if isinstance(message, CloseMessage):
            self._jobs.pop(message.id, None)
            known = self._flows.pop(message.id, None)
            return [_closing(message.id)] if known else []
        return []

    def _call(self, message: CallMessage, now: float) -> list[Callable[[int], WireMessage]]:
        api = self._model.catalogue.apis.get(message.api)
        if api is None or api.kind is not ApiKind.SERVICE:
            return [_error(message.id, ErrorCode.UNKNOWN_API, f"no service {message.api}")]
        if len(self._jobs) >= _MOST_CONVERSATIONS:
            return [_error(message.id, ErrorCode.BUSY, f"{_MOST_CONVERSATIONS} calls wait")]
        try:
            answer = self._model.call(api.name, fit(api.input, message.values, api.name), now)
        except WireError as error:
            return [_error(message.id, ErrorCode.BAD_INPUT, str(error))]
        except ValueError as error:
            return [_error(message.id, ErrorCode.FAILED, str(error))]
        if callable(answer):
            self._jobs[message.id] = (api, answer)
            return []
        return [_result(message.id, api, answer)]

    def _open(self, message: OpenMessage, now: float) -> list[Callable[[int], WireMessage]]:
        api = self._model.catalogue.apis.get(message.api)
        fields = api and (api.input if message.direction is Direction.INPUT else api.output)
        if api is None or api.kind is not ApiKind.FLOW or not fields:
            text = f"no {message.direction.value} {message.api}"
            return [_error(message.id, ErrorCode.UNKNOWN_API, text)]
        if len(self._flows) >= _MOST_CONVERSATIONS:
            return [_error(message.id, ErrorCode.BUSY, f"{_MOST_CONVERSATIONS} flows are open")]
        # What happened before, such as by messages that came in one read with this one, is sent
        # to those flows alone that were open then.
        before = self._events(now)
        self._flows[message.id] = _OpenFlow(api, message.direction, now)
        name, identity, way = api.name, message.id, message.direction
        return [*before, lambda seq: OpenMessage(seq, identity, name, way)]

    def _take(self, message: DataMessage, now: float) -> list[Callable[[int], WireMessage]]:
        flow = self._flows.get(message.id)
        if flow is None or flow.direction is not Direction.INPUT:
            return []
        try:
            values = fit(flow.api.input, message.values, flow.api.name)
        except WireError as error:
            del self._flows[message.id]
            return [_error(message.id, ErrorCode.BAD_INPUT, str(error))]
        self._model.take(flow.api.name, values, now)
        return []


def _result(identity: int, api: Api, values: Values) -> Callable[[int], WireMessage]:
    fitted = fit(api.output, values, api.name)
    return lambda seq: ResultMessage(seq, identity, fitted)


def _data(identity: int, api: Api, values: Values, now: float) -> Callable[[int], WireMessage]:
    fitted = fit(api.output, values, api.name)
    return lambda seq: DataMessage(seq, identity, fitted, now)


def _closing(identity: int) -> Callable[[int], WireMessage]:
    return lambda seq: CloseMessage(seq, identity)


def _error(identity: int, code: ErrorCode, text: str) -> Callable[[int], WireMessage]:
    return lambda seq: ErrorMessage(seq, identity, code, text)


_STOP_SECONDS = 0.5
_USUAL_SPEED = 0.25


def robot_catalogue() -> DeviceCatalogue:
    """Return the catalogue that the simulated robot offers."""
    return load_catalogue(Path(__file__).with_name("robot.xml"))


class SimulatedRobot:
    """Moves by the kinematics of a unicycle, integrated from one look at the clock to the next.

    Args:
        catalogue: replaces the robot's own, to see how a host takes it.
    """

    def __init__(self, catalogue: DeviceCatalogue | None = None) -> None:
        self.catalogue = catalogue or robot_catalogue()
        self._x = self._y = self._heading = 0.0
        self._linear = self._angular = 0.0
        self._until = 0.0
        self._at: float | None = None
        self._command = 0

    def call(self, api: str, values: dict[str, Any], now: float) -> dict[str, Any] | Job:
        """Answer `echo` at once, `driveStraight` when it is done."""
        if api == "echo":
            return values
        if api == "driveStraight":
            return self._drive(values["distance"], values.get("speed", _USUAL_SPEED), now)
        raise ValueError(f"the simulated robot does not know how to {api}")

    def sample(self, api: str, now: float) -> dict[str, Any] | None:
        """Return the odometry."""
        del api
        self._move(now)
        return {"x": self._x, "y": self._y, "heading": self._heading}

    def events(self, now: float) -> list[tuple[str, dict[str, Any]]]:
        """Return nothing: every flow from this robot has a period."""
        del now
        return []

    def take(self, api: str, values: dict[str, Any], now: float) -> None:
        """Take a velocity for half a second."""
        del api
        self._move(now)
        self._command += 1
        self._linear, self._angular = values["linear"], values["angular"]
        self._until = now + _STOP_SECONDS

    def _drive(self, distance: float, speed: float, now: float) -> Job:
        self._move(now)
        self._command += 1
        mine, needed = self._command, abs(distance) / speed
        velocity = math.copysign(speed, distance)
        self._linear, self._angular = velocity, 0.0
        self._until = now + needed

        def job(later: float) -> dict[str, Any] | None:
            if self._command != mine:
                return {"outcome": "interrupted", "driven": velocity * min(later - now, needed)}
            self._move(later)
            return {"outcome": "arrived", "driven": distance} if later >= now + needed else None

        return job

    def _move(self, now: float) -> None:
        begin = now if self._at is None else self._at
        lasted = max(0.0, min(now, self._until) - begin)
        turned = self._angular * lasted
        middle = self._heading + turned / 2
        self._x += self._linear * lasted * math.cos(middle)
        self._y += self._linear * lasted * math.sin(middle)
        self._heading = math.remainder(self._heading + turned, 2 * math.pi)
        self._at = now
