"""Serialising one message: `uoarm.cdr` beside Fast CDR (rclpy), rosbags, omniORB and genpy.

Each peer that is not installed is left out, and said. Times are of one call in one thread.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from bench._schema_cases import zero_message
from bench.ros1_relay import PEER, ROS_PYTHON
from bench.tables import microseconds, print_table, row
from uoarm.cdr import CORBA, ROS_1, Codec, RosDefinition, structure_of_definition

COUNT, OCTETS = 720, 921_600
ROUNDS = 300
NUMBERS = [index / 7 for index in range(COUNT)]
RULE = "=" * 80
Actions = tuple[Callable[[], object], Callable[[], object]]
TYPES = {
    "Imu": "sensor_msgs/msg/Imu",
    "LaserScan, lists": "sensor_msgs/msg/LaserScan",
    "LaserScan, numpy": "sensor_msgs/msg/LaserScan",
    "Path of 20": "nav_msgs/msg/Path",
    "Image": "sensor_msgs/msg/Image",
}


def main() -> int:
    """Print a table for each encoding; 0 also where no peer is installed."""
    for title, rows in (
        ("DDS (ROS 2), us a message", _of_dds()),
        ("ROS 1, us a message", _of_ros_1()),
        ("CORBA, us a message", _of_corba()),
    ):
        print_table(title, ("message, by", "median", "p99", "direction"), list(rows))
    return 0


def _rows(name: str, makers: Sequence[tuple[str, Actions]]) -> Iterator[tuple[str, ...]]:
    for direction, place in (("write", 0), ("read", 1)):
        for by, actions in makers:
            actions[place]()  # what is generated is generated before
            yield row(f"{name}: {by}", microseconds(actions[place], repeat=ROUNDS), direction)


def _numbers(name: str) -> Any:
    return np.array(NUMBERS, np.float32) if name.endswith("numpy") else list(NUMBERS)


def _values(name: str) -> dict[str, Any]:
    """Return what differs from zero in a message."""
    if name.startswith("LaserScan"):
        return {"ranges": _numbers(name), "intensities": _numbers(name)}
    if name == "Image":
        size = {"height": 480, "width": 640, "step": 1920, "encoding": "rgb8"}
        return {**size, "is_bigendian": 0, "data": bytes(OCTETS)}
    return {}


def _ours(codec: Codec, message: Any) -> tuple[str, Actions]:
    written = codec.encode(message, "<")
    return "uoarm", (lambda: codec.encode(message, "<"), lambda: codec.decode(written, "<"))


def _made(name: str, codec_of: Callable[[Any], Codec], structure: Any) -> tuple[str, Actions]:
    given = _values(name)
    if name.startswith("Path"):
        element = structure.schema["properties"]["poses"]["items"]
        given = {"poses": [zero_message(element) for _ in range(20)]}
    return _ours(codec_of(structure), zero_message(structure.schema, given))


def _of_dds() -> Iterator[tuple[str, ...]]:
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    except ImportError as error:
        print(f"no table of DDS: {error}", file=sys.stderr)
        return
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, kind in TYPES.items():
        text, _ = store.generate_msgdef(kind, ros_version=2)
        structure = structure_of_definition(RosDefinition(kind, text))
        ours = _made(name, Codec, structure)
        written: Any = ours[1][0]()
        made, read = [ours], store.deserialize_cdr(written, kind)
        if not name.endswith("lists"):  # it takes arrays alone
            made.append(("rosbags", _by_rosbags(store, read, written, kind)))
        made += _by_rclpy(name, kind, written)
        yield from _rows(name, made)


def _by_rosbags(store: Any, read: Any, written: bytes, kind: str) -> Actions:
    return (
        lambda: store.serialize_cdr(read, kind),
        lambda: store.deserialize_cdr(written, kind),
    )


def _by_rclpy(name: str, kind: str, written: bytes) -> list[tuple[str, Actions]]:
    try:
        from rclpy.serialization import (  # noqa: PLC0415
            deserialize_message,
            serialize_message,
        )

        package, _, type_name = kind.partition("/msg/")
        native: Any = getattr(import_module(f"{package}.msg"), type_name)
    except ImportError as error:
        print(f"no rclpy for {name}: {error}", file=sys.stderr)
        return []
    message = deserialize_message(written, native)

    def write() -> Any:
        if name.endswith("lists"):  # what the others are given, too
            message.ranges = message.intensities = NUMBERS
        return serialize_message(message)

    return [("rclpy", (write, lambda: deserialize_message(written, native)))]


def _of_ros_1() -> Iterator[tuple[str, ...]]:
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    except ImportError as error:
        print(f"no table of ROS 1: {error}", file=sys.stderr)
        return
    peers = _by_genpy()
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, kind in TYPES.items():
        text, _ = store.generate_msgdef(kind, ros_version=1)
        definition = RosDefinition(kind.replace("/msg/", "/"), text)
        structure = structure_of_definition(definition, is_ros_1=True)
        by, actions = _made(name, lambda structure: Codec(structure, ROS_1), structure)
        actions[0](), actions[1]()
        for direction, place in (("write", 0), ("read", 1)):
            found = microseconds(actions[place], repeat=ROUNDS)
            yield row(f"{name}: {by}", found, direction)
            if name in peers:
                yield row(f"{name}: genpy", peers[name][direction], direction)


def _by_genpy() -> dict[str, Any]:
    words = [ROS_PYTHON, PEER, "genpy", str(COUNT), str(OCTETS)]
    try:
        done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True, timeout=120)
    except (OSError, subprocess.SubprocessError) as error:
        print(f"no genpy: {error}", file=sys.stderr)
        return {}
    return {found["name"]: found for found in map(json.loads, done.stdout.splitlines())}


def _by_omniorb(orb: Any, code: Any, native: Any, written: bytes) -> Actions:
    return (
        lambda: orb.cdrMarshal(code, native, True),
        lambda: orb.cdrUnmarshal(code, written, True),
    )


def _of_corba() -> Iterator[tuple[str, ...]]:
    try:
        import omniORB  # noqa: PLC0415
        from uoarm_rtm.component import Types  # noqa: PLC0415
    except ImportError as error:
        print(f"no table of CORBA: {error}", file=sys.stderr)
        return
    orb = omniORB.CORBA.ORB_init([], omniORB.CORBA.ORB_ID)
    types = Types((), "utf-8")
    for name, kind, value in (
        ("TimedPose3D", "RTC::TimedPose3D", None),
        (f"TimedFloatSeq, {COUNT} in a list", "RTC::TimedFloatSeq", NUMBERS),
        (f"TimedOctetSeq, {OCTETS:,}", "RTC::TimedOctetSeq", bytes(OCTETS)),
    ):
        structure = types.structure(kind)
        message = zero_message(structure.schema, {} if value is None else {"data": value})
        made = [_ours(Codec(structure, CORBA), message)]
        code = omniORB.tcInternal.createTypeCode(types.descriptor(kind))
        written = Codec(structure, CORBA).encode(message, "<")
        native = omniORB.cdrUnmarshal(code, written, True)
        made.append(("omniORB", _by_omniorb(omniORB, code, native, written)))
        yield from _rows(name, made)
    orb.destroy()


if __name__ == "__main__":
    begin = time.monotonic()
    status = main()
    print(f"\n{time.monotonic() - begin:.0f} s", file=sys.stderr)
    sys.exit(status)
