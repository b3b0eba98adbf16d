"""Transforms between frames: chains, times and what is said where there is none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from uoarm_ros2 import _transforms
from uoarm_ros2._transforms import (
    Transformation,
    TransformBuffer,
    TransformError,
)

S = 1_000_000_000
QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))  # to the left, about z


def turn(angle: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)


def put(buffer: TransformBuffer, parent: str, child: str, stamp: int = 0, **parts: Any) -> None:
    is_static = parts.pop("is_static", False)
    buffer.take(parent, child, stamp, Transformation(**parts), is_static=is_static)


def close(got: Transformation, x: float, y: float, z: float, *, angle: float = 0.0) -> None:
    assert got.translation == pytest.approx((x, y, z), abs=1e-9)
    assert matrix(got)[:3, :3] == pytest.approx(
        matrix(Transformation(rotation=turn(angle)))[:3, :3]
    )


def matrix(transformation: Transformation) -> Any:
    """Return the 4 x 4 matrix of a transformation, by the textbook's formula."""
    x, y, z, w = transformation.rotation
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = transformation.translation
    return found


@pytest.fixture
def robot() -> TransformBuffer:
    """A base that drives in the map, with an arm to its left and a camera in front."""
    buffer = TransformBuffer()
    put(buffer, "map", "base", 10 * S, translation=(1.0, 0.0, 0.0))
    put(buffer, "map", "base", 12 * S, translation=(3.0, 0.0, 0.0), rotation=QUARTER)
    put(buffer, "base", "camera", is_static=True, translation=(0.5, 0.0, 0.0))
    put(buffer, "base", "arm", 11 * S, translation=(0.0, 0.2, 0.0))
    return buffer


def test_a_point_of_the_source_is_found_in_the_target(robot: TransformBuffer) -> None:
    at, found = robot.lookup("map", "camera")
    assert at == 12 * S
    close(found, 3.0, 0.5, 0.0, angle=math.pi / 2)
    close(robot.lookup("camera", "map")[1], -0.5, 3.0, 0.0, angle=-math.pi / 2)


def test_without_a_time_it_is_the_latest_that_all_on_the_way_have(robot: TransformBuffer) -> None:
    at, found = robot.lookup("map", "arm")
    assert at == 11 * S
    root = math.sqrt(0.5)
    close(found, 2.0 - 0.2 * root, 0.2 * root, 0.0, angle=math.pi / 4)
    at, found = robot.lookup("arm", "camera")  # by their common parent, not by the map
    close(found, 0.5, -0.2, 0.0)
    assert robot.lookup("base", "camera")[0] == 0


def test_times_between_are_interpolated(robot: TransformBuffer) -> None:
    at, found = robot.lookup("map", "base", 10 * S + S // 2)
    assert at == 10 * S + S // 2
    close(found, 1.5, 0.0, 0.0, angle=math.pi / 8)


def test_of_two_arcs_the_shorter_is_taken(robot: TransformBuffer) -> None:
    other = (-QUARTER[0], -QUARTER[1], -QUARTER[2], -QUARTER[3])  # the same rotation
    put(robot, "map", "base", 14 * S, translation=(3.0, 0.0, 0.0), rotation=other)
    close(robot.lookup("map", "base", 13 * S)[1], 3.0, 0.0, 0.0, angle=math.pi / 2)


def test_a_frame_in_itself_does_nothing(robot: TransformBuffer) -> None:
    close(robot.lookup("map", "map")[1], 0.0, 0.0, 0.0)


def test_a_slash_before_a_name_means_nothing(robot: TransformBuffer) -> None:
    put(robot, "/camera", "/lens", is_static=True)
    assert robot.lookup("/map", "lens")[0] == 12 * S


@pytest.mark.parametrize(
    ("target", "source", "time", "text"),
    [
        (
            "map",
            "nose",
            0,
            "frame 'nose' is not known; known are arm, base, camera, far, map, moon",
        ),
        ("map", "far", 0, "frames 'map' and 'far' are not connected: 'map' is in the tree of "),
        (
            "map",
            "base",
            9 * S,
            "'base' in 'map' is known from 10.000 s to 12.000 s, not at 9.000 s",
        ),
        ("map", "base", 12 * S + 1, "known from 10.000 s to 12.000 s, not at 12.000 s"),
    ],
)
def test_what_is_not_there_says_why(
    robot: TransformBuffer, target: str, source: str, time: int, text: str
) -> None:
    put(robot, "moon", "far", S)
    with pytest.raises(TransformError, match=text):
        robot.lookup(target, source, time)


def test_a_ring_is_reported_and_does_not_hang(robot: TransformBuffer) -> None:
    put(robot, "arm", "map", 12 * S)
    with pytest.raises(TransformError, match="go round in a ring: base in map in arm in base"):
        robot.lookup("base", "camera")


@pytest.mark.parametrize(
    ("parent", "child", "parts", "why"),
    [
        ("map", "map", {}, "frame 'map' is its own parent"),
        ("", "base", {}, "are none"),
        ("map", "b" * 256, {}, "are none"),
        ("map", "base", {"translation": (math.nan, 0, 0)}, "'base' in 'map' is not finite"),
        ("map", "base", {"rotation": (0.0, 0.0, 0.0, 0.0)}, "no rotation"),
    ],
)
def test_what_is_no_transform_is_counted_and_changes_nothing(
    robot: TransformBuffer, parent: str, child: str, parts: dict[str, Any], why: str
) -> None:
    put(robot, parent, child, 13 * S, **parts)
    assert robot.refused == 1
    assert why in robot.why
    assert robot.lookup("map", "base")[0] == 12 * S


def test_ten_seconds_are_kept(robot: TransformBuffer) -> None:
    put(robot, "map", "base", 21 * S)
    with pytest.raises(TransformError, match=r"from 12\.000 s to 21\.000 s"):
        robot.lookup("map", "base", 11 * S)


def test_what_comes_late_is_put_in_its_place(robot: TransformBuffer) -> None:
    put(robot, "map", "base", 11 * S, translation=(9.0, 0.0, 0.0))
    close(robot.lookup("map", "base", 11 * S)[1], 9.0, 0.0, 0.0)
    put(robot, "map", "base", 11 * S, translation=(8.0, 0.0, 0.0))
    close(robot.lookup("map", "base", 11 * S)[1], 8.0, 0.0, 0.0)


def test_a_simulation_that_starts_again_begins_anew(robot: TransformBuffer) -> None:
    put(robot, "map", "base", S)
    assert robot.lookup("map", "base")[0] == S
    put(robot, "odom", "base", 2 * S)
    assert robot.lookup("odom", "base")[0] == 2 * S
    with pytest.raises(TransformError, match="frame 'map' is not known"):
        robot.lookup("map", "base")


def test_of_another_run_what_is_static_stays(robot: TransformBuffer) -> None:
    robot.take("base", "mast", 0, Transformation(), is_static=True)
    robot.forget_moving()
    assert robot.lookup("base", "mast")[0] == 0
    with pytest.raises(TransformError, match="frame 'map' is not known"):
        robot.lookup("map", "base")
    put(robot, "map", "base", 5 * S)
    assert robot.lookup("map", "mast")[0] == 5 * S


def test_frames_and_samples_have_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_transforms, "_MOST_FRAMES", 2)
    monkeypatch.setattr(_transforms, "_MOST_SAMPLES", 10)
    buffer = TransformBuffer()
    put(buffer, "map", "slow", 1)
    for stamp in range(1, 30):
        put(buffer, "map", "fast", stamp)
    put(buffer, "map", "third", 1)
    assert (buffer.refused, buffer.why) == (1, "there are more than 2 frames")
    assert buffer.lookup("map", "slow")[0] == 1
    assert buffer.lookup("map", "fast")[0] == 29
    with pytest.raises(TransformError, match="is known from"):
        buffer.lookup("map", "fast", 19)


numbers = some.floats(-100, 100)
rotations = some.tuples(numbers, numbers, numbers, numbers).filter(
    lambda item: sum(value * value for value in item) > 1
)


@some.composite
def transformations(draw: Any) -> Transformation:
    report = draw(rotations)
    norm = math.sqrt(sum(item * item for item in report))
    x, y, z, w = (item / norm for item in report)
    return Transformation(draw(some.tuples(numbers, numbers, numbers)), (x, y, z, w))


@given(transformations(), transformations())
def test_they_do_as_matrices_do(one: Transformation, two: Transformation) -> None:
    assert np.allclose(matrix(one.after(two)), matrix(one) @ matrix(two), atol=1e-6)
    assert np.allclose(matrix(one.inverse()), np.linalg.inv(matrix(one)), atol=1e-6)
    assert np.allclose(matrix(one.towards(two, 0.0)), matrix(one), atol=1e-6)
    assert np.allclose(matrix(one.towards(two, 1.0)), matrix(two), atol=1e-6)
