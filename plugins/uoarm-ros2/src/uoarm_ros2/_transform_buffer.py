"""Transforms between frames over time, as `/tf` and `/tf_static` tell them: no I/O, no clock.

Rotations are quaternions (x, y, z, w), translations (x, y, z), times nanoseconds of the stamps.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable

from attrs import define, field, frozen

__all__ = ["TransformBuffer", "TransformError", "Transformation"]

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
        moved = _rotated(self.rotation, other.translation)
        return Transformation(
            _sum(self.translation, moved), _product(self.rotation, other.rotation)
        )

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
    """A frame in its parent; of a dynamic one what the last seconds told, oldest first."""

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
        """Take what was told of a frame; what cannot be used is counted in `refused`, with `why`.

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

    def _mistake(self, parent: str, child: str, transformation: Transformation) -> str:
        if not parent or not child or max(len(parent), len(child)) > _MOST_NAME:
            return f"frames {parent!r:.80} and {child!r:.80} are none"
        if parent == child:
            return f"frame {child!r} is told in itself"
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


def _sum(one: Vector, two: Vector) -> Vector:
    return one[0] + two[0], one[1] + two[1], one[2] + two[2]


def _product(one: Quaternion, two: Quaternion) -> Quaternion:
    a, b, c, d = one
    e, f, g, h = two
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


def _slerp(one: Quaternion, two: Quaternion, share: float) -> Quaternion:
    cosine = sum(a * b for a, b in zip(one, two, strict=True))
    sign = -1.0 if cosine < 0 else 1.0  # a rotation has two quaternions; this way is shorter
    angle = math.acos(min(1.0, abs(cosine)))
    sine = math.sin(angle)
    first, second = (1 - share, share)
    if sine > 1e-9:  # noqa: PLR2004 - below it the arc is its chord
        first, second = math.sin(first * angle) / sine, math.sin(second * angle) / sine
    x, y, z, w = (first * a + sign * second * b for a, b in zip(one, two, strict=True))
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return x / norm, y / norm, z / norm, w / norm
