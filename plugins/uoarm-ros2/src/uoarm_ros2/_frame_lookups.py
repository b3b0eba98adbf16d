"""Look-ups between frames: `/tf` and `/tf_static` are heard while somebody asks."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from uoarm.bridge import Description
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Message, MessageStructure
from uoarm_ros2._cdr_read import cdr_reader
from uoarm_ros2._defined import untyped_record
from uoarm_ros2._graph import Graph
from uoarm_ros2._middleware import Station
from uoarm_ros2._qos import Policies, clashes
from uoarm_ros2._schema import schema_of, structure_of
from uoarm_ros2._settings import TF_MESSAGE, Address, Settings
from uoarm_ros2._shape import Field, Listing, Record, shape_of
from uoarm_ros2._transform_buffer import Transformation, TransformBuffer, TransformError
from uoarm_ros2._types import import_type

__all__ = ["FrameLookups", "tf_message"]

_TRANSFORM, _TIME = "geometry_msgs/msg/TransformStamped", "builtin_interfaces/msg/Time"
_WAIT_SECONDS = 1.0
_MOST_SECONDS = 60.0
_IDLE_SECONDS = 60.0
_NANO = 1_000_000_000


@cache  # what a class is made of is never given back
def tf_message() -> type:
    """Return the class for `tf2_msgs/msg/TFMessage`, which no index of packages has."""
    element = _record(_TRANSFORM)
    field = Field("transforms", "transforms", Listing(element))
    return untyped_record(Record(TF_MESSAGE, object, (field,), {}, ())).native


def _record(name: str) -> Record:
    return shape_of(import_type(name), name)


class FrameLookups:
    """The look-ups of one bridge, for each name of a topic as `/tf`; any thread may ask.

    A topic is heard from the first look-up on, until nobody has asked for a minute.

    Args:
        station: hears the topics.
        graph: tells who publishes them.
        find: returns the class of a type that a topic carries; takes both names.
    """

    def __init__(self, station: Station, graph: Graph, find: Callable[[str, str], type]) -> None:
        self._station = station
        self._graph = graph
        self._find = find
        self._lock = threading.Lock()
        self._listeners: dict[str, _Listener] = {}
        self._closed = False

    def describe(self, address: Address, settings: Settings) -> Description:
        """Return what a look-up takes and gives.

        Raises:
            BridgeError: nobody publishes, and somebody must.
        """
        topics = self._topics(address)

        def there() -> bool:
            return any(self._station.publishers(topic) for topic in topics)

        what = f"a publisher of {' or '.join(topics)}"
        if settings.peer_required and not self._graph.settled(what, there, settings):
            text = self._graph.absence(f"there is no {what[2:]}", topics[0], self._station.topics())
            raise BridgeError(text, FailureReason.NOT_FOUND)
        reply = structure_of(_record(_TRANSFORM))
        return Description(request=MessageStructure(_request_schema()), reply=reply)

    def call(self, address: Address, message: Message, seconds: float) -> Message:
        """Look one frame up in another; waits for it as long as the request and `seconds` say.

        Raises:
            BridgeError: there is no such transform, for the reason that the text gives.
            MessageError: the request is none.
        """
        target, source, at, wait = _asked(message)
        topics = self._topics(address)
        with self._lock:
            if self._closed:
                raise BridgeError("the bridge is closed", FailureReason.CLOSED)
            listener = self._listeners.get(topics[0])
            if listener is None:
                native = self._find(address.type, address.name)
                listener = self._listeners[topics[0]] = _Listener(self._station, topics, native)
            listener.users += 1
        try:
            return listener.look_up(target, source, at, min(wait, seconds))
        finally:
            with self._lock:
                listener.users -= 1
                listener.used = time.monotonic()

    def tick(self) -> None:
        """Stop to hear what nobody asks for any more."""
        now = time.monotonic()
        with self._lock:
            idle = [
                name
                for name, listener in self._listeners.items()
                if not listener.users and now - listener.used > _IDLE_SECONDS
            ]
            gone = [self._listeners.pop(name) for name in idle]
        for listener in gone:
            listener.close()

    def close(self) -> None:
        """End all look-ups; those that wait fail."""
        with self._lock:
            self._closed = True
            gone = list(self._listeners.values())
            self._listeners.clear()
        for listener in gone:
            listener.close()

    def _topics(self, address: Address) -> tuple[str, str]:
        name = self._station.topic_name(address.name)
        return name, f"{name}_static"


class _Listener:
    """Both topics of one name, and what they told."""

    def __init__(self, station: Station, topics: tuple[str, str], native: type) -> None:
        self._station = station
        self._topics = dict(
            zip(topics, (Policies(), Policies(durability="transient_local")), strict=True)
        )
        self._changed = threading.Condition()
        self._buffer = TransformBuffer()
        self._read = cdr_reader(shape_of(native, TF_MESSAGE))
        self._unread = ""
        self._closed = False
        self.users = 0
        self.used = time.monotonic()
        self._subscriptions = [
            station.subscribe(
                native,
                topic,
                policies,
                self._take_static if policies.durability == "transient_local" else self._take,
                events={},
            )
            for topic, policies in self._topics.items()
        ]

    def look_up(self, target: str, source: str, at: int, seconds: float) -> Message:
        deadline = time.monotonic() + seconds
        with self._changed:
            while True:
                if self._closed:
                    raise BridgeError("the bridge was closed", FailureReason.CLOSED)
                try:
                    stamp, found = self._buffer.lookup(target, source, at)
                except TransformError as error:
                    left = deadline - time.monotonic()
                    if left > 0:
                        self._changed.wait(left)
                        continue
                    raise self._failed(error, seconds) from error
                return _reply(target, source, stamp, found)

    def _failed(self, error: TransformError, seconds: float) -> BridgeError:
        reports = [f"{error}, after {seconds:g} s"]
        for topic, policies in self._topics.items():
            for peer in self._station.publishers(topic):
                wrong = clashes(peer.policies, policies)
                if wrong:
                    reports.append(f"{peer.node} is not heard on {topic}: {', '.join(wrong)}")
        if self._buffer.refused:
            reports.append(
                f"{self._buffer.refused} transforms were refused, last: {self._buffer.why}"
            )
        if self._unread:
            reports.append(self._unread)
        return BridgeError("; ".join(reports), FailureReason.NOT_FOUND)

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for subscription in self._subscriptions:
            self._station.discard(subscription)

    def _take(self, octets: bytes, *, is_static: bool = False) -> None:
        try:
            message: Any = self._read(octets)
        except MessageError as error:
            self._unread = f"a message could not be read: {error}"
            return
        with self._changed:
            for transform in message["transforms"]:
                stamp = transform["header"]["stamp"]
                report = transform["transform"]
                move, turn = report["translation"], report["rotation"]
                self._buffer.take(
                    transform["header"]["frame_id"],
                    transform["child_frame_id"],
                    stamp["sec"] * _NANO + stamp["nanosec"],
                    Transformation(
                        (move["x"], move["y"], move["z"]),
                        (turn["x"], turn["y"], turn["z"], turn["w"]),
                    ),
                    is_static=is_static,
                )
            self._changed.notify_all()

    def _take_static(self, octets: bytes) -> None:
        self._take(octets, is_static=True)


def _request_schema() -> dict[str, Any]:
    frame = {"type": "string", "minLength": 1, "maxLength": 255}
    return {
        "type": "object",
        "properties": {
            "target_frame": frame,
            "source_frame": frame,
            "time": schema_of(_record(_TIME)),
            "timeout": {
                "type": "number",
                "minimum": 0,
                "maximum": _MOST_SECONDS,
                "default": _WAIT_SECONDS,
                "x-unit": "s",
            },
        },
        "required": ["target_frame", "source_frame"],
        "additionalProperties": False,
    }


def _asked(message: Any) -> tuple[str, str, int, float]:
    """Return the frames, the time and the seconds to wait."""
    if not isinstance(message, Mapping):
        raise MessageError(f"a look-up is an object, got {type(message).__name__}")
    unknown = sorted({*message} - {"target_frame", "source_frame", "time", "timeout"})
    if unknown:
        raise MessageError(f"a look-up has no field {unknown[0]!r:.60}")
    frames = [message.get(name) for name in ("target_frame", "source_frame")]
    if not all(isinstance(frame, str) and frame for frame in frames):
        raise MessageError("target_frame and source_frame must be names of frames")
    at, wait = message.get("time", {}), message.get("timeout", _WAIT_SECONDS)
    try:
        stamp = int(at.get("sec", 0)) * _NANO + int(at.get("nanosec", 0))
        seconds = float(wait)
    except (AttributeError, TypeError, ValueError) as error:
        raise MessageError(f"time must be {{sec, nanosec}}, timeout seconds: {error}") from error
    if not 0 <= seconds <= _MOST_SECONDS:
        raise MessageError(f"timeout must be 0 to {_MOST_SECONDS:g} s, got {seconds:g}")
    return str(frames[0]), str(frames[1]), stamp, seconds


def _reply(target: str, source: str, stamp: int, found: Transformation) -> Message:
    seconds, nanoseconds = divmod(stamp, _NANO)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": target},
        "child_frame_id": source,
        "transform": {
            "translation": dict(zip("xyz", found.translation, strict=True)),
            "rotation": dict(zip("xyzw", found.rotation, strict=True)),
        },
    }
