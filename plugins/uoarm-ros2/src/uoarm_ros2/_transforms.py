"""Look-ups between frames, from the transforms of `/tf` and `/tf_static` over time.

Rotations are quaternions (x, y, z, w), translations (x, y, z), times nanoseconds of the stamps.
"""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from attrs import define, field, frozen

from uoarm.bridge import Description
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Message, MessageStructure
from uoarm_ros2._conversion import codec_of
from uoarm_ros2._discovery import Ros2Graph
from uoarm_ros2._middleware import NodeRunner
from uoarm_ros2._options import TF_MESSAGE, Ros2Address, Ros2Options
from uoarm_ros2._qos import Policies, clashes
from uoarm_ros2._types import RecordType, import_type, schema_of, shape_of, structure_of

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

HISTORY = 10_000_000_000  # nanoseconds, as ROS 2 keeps
_MOST_FRAMES = 4_096
_MOST_SAMPLES = 200_000
_MOST_NAME = 255
_MOST_NAMED = 12
_NORM_ERROR = 0.01  # of the squared norm: what ROS 2 takes for a rotation


class TransformError(Exception):
    """There is no such transform, for now; the text says why."""


@frozen
class Transformation:
    """What turns points of one frame into those of another: rotated, then moved."""

    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def after(self, other: Transformation) -> Transformation:
        """Return the one that does `other` first, then this."""
        x, y, z = _rotated(self.rotation, other.translation)
        a, b, c = self.translation
        return Transformation((a + x, b + y, c + z), _product(self.rotation, other.rotation))

    def inverse(self) -> Transformation:
        """Return the one that undoes this."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        a, b, c = _rotated(back, self.translation)
        return Transformation((-a, -b, -c), back)

    def towards(self, other: Transformation, share: float) -> Transformation:
        """Return what lies between: on the line, and on the shorter arc (slerp)."""
        pairs = zip(self.translation, other.translation, strict=True)
        a, b, c = (value + (two - value) * share for value, two in pairs)
        return Transformation((a, b, c), _slerp(self.rotation, other.rotation, share))


@define
class _Edge:
    """A frame in its parent; of a dynamic one the samples of the last seconds, oldest first."""

    parent: str
    is_static: bool
    stamps: list[int] = field(factory=list)
    values: list[Transformation] = field(factory=list)

    def at(self, child: str, time: int) -> Transformation:
        if self.is_static:
            return self.values[0]
        place = bisect_left(self.stamps, time)
        if place < len(self.stamps) and self.stamps[place] == time:
            return self.values[place]
        if place in (0, len(self.stamps)):
            first, last = self.stamps[0] / 1e9, self.stamps[-1] / 1e9
            raise TransformError(
                f"{child!r} in {self.parent!r} is known from {first:.3f} s to {last:.3f} s, not at "
                f"{time / 1e9:.3f} s"
            )
        before, after = self.stamps[place - 1], self.stamps[place]
        share = (time - before) / (after - before)
        return self.values[place - 1].towards(self.values[place], share)


class TransformBuffer:
    """Keeps ten seconds of each frame, and answers where one was in another.

    Not thread-safe. It has a budget of 4,096 frames and 200,000 samples: a frame beyond is not
    taken; where there are more samples, that frame that has most loses the older half of its.
    """

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}
        self._samples = 0
        self.refused = 0
        self.why = ""

    def take(
        self,
        parent: str,
        child: str,
        stamp: int,
        transformation: Transformation,
        *,
        is_static: bool,
    ) -> None:
        """Take a sample of a frame; what cannot be used is counted in `refused`, with `why`.

        What is older than the history by then is another run of a simulation or a recording: the
        frame's history begins anew, as it does when its parent changes.
        """
        parent, child = parent.lstrip("/"), child.lstrip("/")
        why = self._mistake(parent, child, transformation)
        if why:
            self.refused += 1
            self.why = why
            return
        edge = self._edges.get(child)
        if (
            edge is None
            or is_static
            or edge.is_static
            or edge.parent != parent
            or stamp < edge.stamps[-1] - HISTORY
        ):
            self._samples += 1 - (len(edge.stamps) if edge else 0)
            self._edges[child] = _Edge(parent, is_static, [stamp], [transformation])
            return
        place = bisect_right(edge.stamps, stamp)
        if place and edge.stamps[place - 1] == stamp:
            edge.values[place - 1] = transformation
            return
        edge.stamps.insert(place, stamp)
        edge.values.insert(place, transformation)
        self._samples += 1
        self._forget(edge, bisect_left(edge.stamps, edge.stamps[-1] - HISTORY))
        if self._samples > _MOST_SAMPLES:
            longest = max(self._edges.values(), key=lambda item: len(item.stamps))
            self._forget(longest, len(longest.stamps) // 2)

    def forget_moving(self) -> None:
        """Keep what is static alone, as where another run of a simulation begins."""
        self._edges = {child: edge for child, edge in self._edges.items() if edge.is_static}
        self._samples = len(self._edges)

    def _mistake(self, parent: str, child: str, transformation: Transformation) -> str:
        if not parent or not child or max(len(parent), len(child)) > _MOST_NAME:
            return f"frames {parent!r:.80} and {child!r:.80} are none"
        if parent == child:
            return f"frame {child!r} is its own parent"
        if not all(map(math.isfinite, transformation.translation + transformation.rotation)):
            return f"{child!r} in {parent!r} is not finite"
        if abs(sum(value * value for value in transformation.rotation) - 1) > _NORM_ERROR:
            return f"{child!r} in {parent!r} is turned by {transformation.rotation}, no rotation"
        if child not in self._edges and len(self._edges) >= _MOST_FRAMES:
            return f"there are more than {_MOST_FRAMES:,} frames"
        return ""

    def _forget(self, edge: _Edge, number: int) -> None:
        if number:
            del edge.stamps[:number]
            del edge.values[:number]
            self._samples -= number

    def lookup(self, target: str, source: str, time: int = 0) -> tuple[int, Transformation]:
        """Return what turns points of `source` into those of `target`, and its time.

        Args:
            target: a frame's name.
            source: another's.
            time: when; 0: the latest that all frames on the way have, 0 where all are static.

        Raises:
            TransformError: a frame is not known, nothing connects them, or not at that time.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        to_target, to_source = self._ancestors(target), self._ancestors(source)
        if to_target[-1] != to_source[-1]:
            raise TransformError(
                f"frames {target!r} and {source!r} are not connected: {target!r} is in the tree of "
                f"{to_target[-1]!r}, {source!r} in that of {to_source[-1]!r}"
            )
        above = set(to_target)
        common = next(name for name in to_source if name in above)
        up = to_source[: to_source.index(common)]
        down = to_target[: to_target.index(common)]
        moving = [self._edges[name] for name in (*up, *down) if not self._edges[name].is_static]
        at = time or min((edge.stamps[-1] for edge in moving), default=0)
        return at, self._chained(down, at).inverse().after(self._chained(up, at))

    def _chained(self, frames: Iterable[str], time: int) -> Transformation:
        found = Transformation()
        for frame in frames:
            found = self._edges[frame].at(frame, time).after(found)
        return found

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame and all above it, up to the root of its tree."""
        if frame not in self._edges and all(edge.parent != frame for edge in self._edges.values()):
            known = sorted({*self._edges, *(edge.parent for edge in self._edges.values())})
            more = f" and {len(known) - _MOST_NAMED} more" if len(known) > _MOST_NAMED else ""
            text = f"known are {', '.join(known[:_MOST_NAMED])}{more}" if known else "none is"
            raise TransformError(f"frame {frame!r:.100} is not known; {text}")
        found = [frame]
        seen = {frame}
        while found[-1] in self._edges:
            parent = self._edges[found[-1]].parent
            if parent in seen:
                raise TransformError(f"frames go round in a ring: {' in '.join(found)} in {parent}")
            found.append(parent)
            seen.add(parent)
        return found


def _product(first: Quaternion, second: Quaternion) -> Quaternion:
    a, b, c, d = first
    e, f, g, h = second
    return (
        d * e + a * h + b * g - c * f,
        d * f - a * g + b * h + c * e,
        d * g + a * f - b * e + c * h,
        d * h - a * e - b * f - c * g,
    )


def _rotated(rotation: Quaternion, vector: Vector) -> Vector:
    x, y, z, w = rotation
    turned = _product(_product(rotation, (*vector, 0.0)), (-x, -y, -z, w))
    return turned[0], turned[1], turned[2]


def _slerp(start: Quaternion, end: Quaternion, share: float) -> Quaternion:
    cosine = sum(a * b for a, b in zip(start, end, strict=True))
    sign = -1.0 if cosine < 0 else 1.0  # a rotation has two quaternions; this way is shorter
    angle = math.acos(min(1.0, abs(cosine)))
    sine = math.sin(angle)
    first, second = (1 - share, share)
    if sine > 1e-9:  # noqa: PLR2004 - below it the arc is its chord
        first, second = math.sin(first * angle) / sine, math.sin(second * angle) / sine
    x, y, z, w = (first * a + sign * second * b for a, b in zip(start, end, strict=True))
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return x / norm, y / norm, z / norm, w / norm


_TRANSFORM, _TIME = "geometry_msgs/msg/TransformStamped", "builtin_interfaces/msg/Time"
_WAIT_SECONDS = 1.0
_MOST_SECONDS = 60.0
_IDLE_SECONDS = 60.0
_NANO = 1_000_000_000


def _record(name: str) -> RecordType:
    return shape_of(import_type(name), name)


class FrameLookups:
    """The look-ups of one bridge, for each name of a topic as `/tf`; any thread may ask.

    A topic is subscribed to from the first look-up on, until there was none for a minute.

    Args:
        find: returns the class of a type that a topic carries; takes both names.
    """

    def __init__(
        self, runner: NodeRunner, graph: Ros2Graph, find: Callable[[str, str], type]
    ) -> None:
        self._runner = runner
        self._graph = graph
        self._find = find
        # Guards the listeners and how many look-ups use each: `tick` closes none that a look-up
        # has just been given.
        self._lock = threading.Lock()
        self._listeners: dict[str, _TransformListener] = {}
        self._closed = False

    def describe(self, address: Ros2Address, options: Ros2Options) -> Description:
        """Return what a look-up takes and gives.

        Raises:
            BridgeError: there is no publisher, and one is required.
        """
        topics = self._topics(address)

        def there() -> bool:
            return any(self._runner.publishers(topic) for topic in topics)

        what = f"a publisher of {' or '.join(topics)}"
        if options.peer_required and not self._graph.settled(what, there, options):
            text = self._graph.absence(f"there is no {what[2:]}", topics[0], self._runner.topics())
            raise BridgeError(text, FailureReason.NOT_FOUND)
        reply = structure_of(_record(_TRANSFORM))
        return Description(request=MessageStructure(_request_schema()), reply=reply)

    def call(self, address: Ros2Address, message: Message, seconds: float) -> Message:
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
                listener = self._listeners[topics[0]] = _TransformListener(
                    self._runner, topics, native
                )
            listener.users += 1
        try:
            return listener.look_up(target, source, at, min(wait, seconds))
        finally:
            with self._lock:
                listener.users -= 1
                listener.used = time.monotonic()

    def tick(self) -> None:
        """Unsubscribe from topics without look-ups."""
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

    def forget_moving(self) -> None:
        """Forget the transforms of `/tf`: another run of the simulation has begun."""
        with self._lock:
            listeners = list(self._listeners.values())
        for listener in listeners:
            listener.forget_moving()

    def close(self) -> None:
        """End all look-ups; those that wait fail."""
        with self._lock:
            self._closed = True
            gone = list(self._listeners.values())
            self._listeners.clear()
        for listener in gone:
            listener.close()

    def _topics(self, address: Ros2Address) -> tuple[str, str]:
        name = self._runner.topic_name(address.name)
        return name, f"{name}_static"


class _TransformListener:
    """Both topics of one name, and the transforms that came."""

    def __init__(self, runner: NodeRunner, topics: tuple[str, str], native: type) -> None:
        self._runner = runner
        self._topics = dict(
            zip(topics, (Policies(), Policies(durability="transient_local")), strict=True)
        )
        # Guards the buffer, which the runner's thread fills, from look-ups in other threads, and
        # wakes them with each message.
        self._changed = threading.Condition()
        self._buffer = TransformBuffer()
        self._read = codec_of(shape_of(native, TF_MESSAGE)).decode
        self._unread = ""
        self._closed = False
        self.users = 0
        self.used = time.monotonic()
        self._subscriptions = [
            runner.subscribe(
                native,
                topic,
                policies,
                partial(self._take, is_static=policies.durability == "transient_local"),
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
            for peer in self._runner.publishers(topic):
                wrong = clashes(peer.policies, policies)
                if wrong:
                    reports.append(f"{peer.node} is not received on {topic}: {', '.join(wrong)}")
        if self._buffer.refused:
            reports.append(
                f"{self._buffer.refused} transforms were refused, last: {self._buffer.why}"
            )
        if self._unread:
            reports.append(self._unread)
        return BridgeError("; ".join(reports), FailureReason.NOT_FOUND)

    def forget_moving(self) -> None:
        with self._changed:
            self._buffer.forget_moving()

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for subscription in self._subscriptions:
            self._runner.discard(subscription)

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
