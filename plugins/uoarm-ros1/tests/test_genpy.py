"""Messages, sums and definitions are those of rospy's own genpy."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from typing import Any

import pytest
from peers import HERE, ROS_PYTHON
from tests.processes import run_program  # type: ignore[import-not-found]
from uoarm_ros1._definitions import RosRecord, record_of
from uoarm_ros1._types import TypeStore, noetic_definition

from uoarm.cdr import ROS_1, Codec
from uoarm.model import Budget
from uoarm.testing import same

PACKAGES = (
    "std_msgs",
    "geometry_msgs",
    "sensor_msgs",
    "nav_msgs",
    "actionlib_msgs",
    "actionlib",
    "tf2_msgs",
    "rosgraph_msgs",
)
EACH = 80
LISTING = """
import importlib, sys
for package in sys.argv[1:]:
    module = importlib.import_module(package + ".msg")
    for name in dir(module):
        if hasattr(getattr(module, name), "_md5sum"):
            print(package + "/" + name)
"""


def lines_of(*words: str) -> Iterator[str]:
    done = run_program(ROS_PYTHON, *words)
    assert done.returncode == 0, done.stderr
    yield from done.stdout.splitlines()


def test_ten_thousand_messages_of_every_type_there_is_are_equal() -> None:
    types = list(lines_of("-c", LISTING, *PACKAGES))
    assert len(types) >= 50
    record: RosRecord | None = None
    count = 0
    for line in lines_of(str(HERE / "debian" / "genpy_messages.py"), "1", str(EACH), *types):
        given: dict[str, Any] = json.loads(line)
        if "type" in given:
            record = record_of(given["type"], given["definition"])
            assert record.md5 == given["md5"], record.name
            codec = Codec(record.structure, ROS_1, Budget())
            continue
        assert record is not None
        octets = base64.b64decode(given["octets"])
        message = codec.decode(octets, "<")
        assert same(message, given["value"]), record.name
        assert codec.encode(message, "<") == octets, record.name
        assert codec.encode(given["value"], "<") == octets, record.name
        count += 1
    assert count == EACH * len(types) >= 10_000


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_known_without_ros_has_the_sums_of_ros(package: str) -> None:
    store = TypeStore(())
    words = "import json, sys, importlib\nm = importlib.import_module(sys.argv[1] + '.msg')\n"
    words += "print(json.dumps({n: getattr(m, n)._md5sum for n in dir(m) if hasattr("
    words += "getattr(m, n), '_md5sum')}))"
    (line,) = lines_of("-c", words, package)
    for name, md5 in json.loads(line).items():
        full = f"{package}/{name}"
        if noetic_definition(full) is None and full != "tf2_msgs/TFMessage":
            continue  # asked of those who publish it, or of folders
        record = store.message(full)
        assert record is not None
        assert record.md5 == md5, full
