"""What tests need beyond `.[dev]`: whether it is here, and how to get it."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest
from attrs import field, frozen


@frozen
class Need:
    """Something that not every machine has.

    Attributes:
        programs: of which one must be on the PATH.
        packages: Python modules that must all be importable.
        files: patterns of paths below the root folder, of which one must match.
        get: how to get it.
        systems: where it exists at all, as system and machine; everywhere when empty.
    """

    get: str
    programs: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    systems: frozenset[tuple[str, str]] = field(default=frozenset())

    @property
    def exists(self) -> bool:
        """Whether it can be had for this kind of machine."""
        return not self.systems or (platform.system(), platform.machine()) in self.systems

    @property
    def found(self) -> list[Path]:
        """Return the files that match."""
        return [path for pattern in self.files for path in Path("/").glob(pattern)]

    @property
    def lacking(self) -> str:
        """Return what of it is not here; empty when nothing is missing."""
        gone = [name for name in self.packages if find_spec(name) is None]
        if self.programs and not any(map(shutil.which, self.programs)):
            gone.append(self.programs[0])
        if self.files and not self.found:
            gone.append(Path(self.files[0]).name)
        return ", ".join(gone)


VISION = "pip install -e '.[vision-lbph,vision-dlib]'"
ROS = frozenset({("Linux", "x86_64")})
NEEDS = {
    "record": Need("pip install -e '.[record]'", packages=("mcap", "orjson", "cbor2")),
    "bags": Need("pip install -e '.[bags]'", packages=("rosbags",)),
    "vision": Need(VISION, packages=("cv2", "dlib", "face_recognition_models")),
    "records": Need(
        "pip install -e '.[healthbot]'", packages=("httpx", "sqlalchemy", "starlette", "uvicorn")
    ),
    "ros2": Need(
        "pip install -e plugins/uoarm-rosbridge -e 'plugins/uoarm-ros2[dev]'",
        packages=("rclpy",),
        systems=ROS,
    ),
    "compiler": Need("apt install gcc g++", programs=("gcc", "cc")),
    "otlp": Need("pip install -e '.[dev]'", packages=("opentelemetry.exporter",)),
    "zeroconf": Need("pip install -e '.[dev]'", packages=("zeroconf",)),
    "diagnostic_msgs": Need(
        "pip install -e 'plugins/uoarm-ros2[dev]'", packages=("diagnostic_msgs",), systems=ROS
    ),
    "rtm": Need(
        "pip install -e 'plugins/uoarm-rtm[dev]'",
        packages=("uoarm_rtm", "_uoarm_rtm_stubs", "omniORB"),
    ),
    "rocos": Need(
        "pip install -e 'plugins/uoarm-rocos[dev]'",
        packages=("uoarm_rocos", "serial", "espeakng_loader"),
    ),
    "mqtt": Need(
        "pip install -e 'plugins/uoarm-mqtt[dev]'", packages=("uoarm_mqtt", "paho", "trustme")
    ),
    "vda5050": Need(
        "pip install -e 'plugins/uoarm-mqtt[dev]' -e 'plugins/uoarm-vda5050[dev]'",
        packages=("uoarm_vda5050", "paho", "trustme"),
    ),
    "mosquitto": Need("apt install mosquitto", programs=("mosquitto", "/usr/sbin/mosquitto")),
    "nginx": Need("apt install nginx", programs=("nginx", "/usr/sbin/nginx")),
    "mosquitto-clients": Need("apt install mosquitto-clients", programs=("mosquitto_sub",)),
    "ros1": Need("pip install -e 'plugins/uoarm-ros1[dev]'", packages=("uoarm_ros1", "rosbags")),
    "rospy": Need(
        "apt install python3-rosmaster python3-rospy python3-std-msgs python3-sensor-msgs "
        "python3-nav-msgs "
        "python3-std-srvs python3-actionlib python3-tf2-ros",
        files=("usr/lib/python3/dist-packages/rospy/__init__.py",),
    ),
    "roscpp": Need(
        "apt install libroscpp-dev libactionlib-dev g++",
        programs=("g++",),
        files=("usr/include/ros/ros.h",),
    ),
    "rosbridge": Need(
        "pip install -e 'plugins/uoarm-rosbridge[dev]'", packages=("uoarm_rosbridge", "roslibpy")
    ),
    "foxglove": Need("pip install -e 'plugins/uoarm-foxglove[dev]'", packages=("uoarm_foxglove",)),
    "remote": Need("pip install -e 'plugins/uoarm-remote[dev]'", packages=("uoarm_remote",)),
    "mcp": Need("pip install -e 'plugins/uoarm-mcp[dev]'", packages=("uoarm_mcp", "mcp")),
    "chromium": Need(
        "apt install chromium, or Chrome on the PATH",
        programs=("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"),
    ),
    "node": Need("Node.js 20.10 or later: apt install nodejs", programs=("node",)),
    "npm": Need("apt install npm", programs=("npm",)),
    "faketime": Need(
        "apt install libfaketime",
        files=(
            "usr/lib/*/faketime/libfaketimeMT.so.1",
            "usr/lib/faketime/libfaketimeMT.so.1",
        ),
    ),
    "systemd": Need("apt install systemd", programs=("systemd-analyze",)),
    "festival": Need("apt install festival festvox-kallpc16k", programs=("text2wave",)),
}
HEALTHBOT = ("ros2", "rtm", "rocos", "records", "vision")

MODULES = {
    "tests/examples/test_vision_*.py": ("vision",),
    "tests/examples/test_records.py": ("records",),
    "tests/server/test_telemetry.py": ("otlp",),
    "tests/server/test_announcing.py": ("zeroconf",),
    "tests/record/*": ("record",),
    "tests/examples/test_recording.py": ("record",),
    "tests/cli/test_record.py": ("record",),
    "tests/examples/test_healthbot.py": HEALTHBOT,
    "tests/examples/test_fleet.py": ("remote",),
    "tests/examples/test_mixed.py": ("ros2", "ros1", "mqtt", "mosquitto"),
    "tests/examples/test_warehouse.py": ("ros2", "rtm", "vda5050", "mosquitto"),
    "tests/examples/test_warehouse_broker.py": ("rtm", "mosquitto"),
    "plugins/uoarm-ros2/tests/test_rosbridge.py": ("ros2", "rosbridge"),
    "plugins/uoarm-ros2/tests/test_cbor_raw.py": ("ros2", "rosbridge"),
    "plugins/uoarm-ros2/tests/test_navigation_example.py": (
        "ros2",
        "compiler",
        "vda5050",
        "mosquitto",
    ),
    "plugins/uoarm-ros2/tests/test_diagnostics.py": ("ros2", "diagnostic_msgs"),
    "plugins/uoarm-ros2/tests/test_read_diagnostics.py": ("ros2", "diagnostic_msgs"),
    "plugins/uoarm-ros2/tests/*": ("ros2",),
    "plugins/uoarm-rtm/tests/*": ("rtm",),
    "plugins/uoarm-rocos/tests/*": ("rocos",),
    "plugins/uoarm-mqtt/tests/*": ("mqtt", "mosquitto"),
    "plugins/uoarm-vda5050/tests/*": ("vda5050", "mosquitto"),
    "plugins/uoarm-ros1/tests/test_engine.py": ("ros1",),
    "plugins/uoarm-ros1/tests/test_roscpp.py": ("ros1", "rospy", "roscpp"),
    "plugins/uoarm-ros1/tests/*": ("ros1", "rospy"),
    "plugins/uoarm-rosbridge/tests/*": ("rosbridge",),
    "plugins/uoarm-foxglove/tests/*": ("foxglove",),
    "plugins/uoarm-remote/tests/test_browsing.py": ("remote", "zeroconf"),
    "plugins/uoarm-remote/tests/*": ("remote",),
    "plugins/uoarm-mcp/tests/*": ("mcp",),
}
"""What a whole module needs, also for being imported."""


PLACES = (
    "tests/cli",
    "tests/environments",
    "tests/examples",
    "tests/packaging",
    "tests/record",
    "tests/server",
    "tests/test_clock_steps.py",
)
"""Where tests of the core are that need something: the others are not imported to look for them."""


KEEPS = {
    # DDS keeps sockets, and the ORB connections and threads, for what comes next.
    "plugins/uoarm-ros2/tests/*": ("descriptor",),
    "plugins/uoarm-rtm/tests/*": ("descriptor", "thread 'omniORB", "thread 'uoarm-rtm-end"),
}
"""What libraries of a whole module give back late or never; see the marker."""


def kept_by_module(path: str) -> tuple[str, ...]:
    """Return what libraries of a module keep, by its path from the root of the repository."""
    return next((kept for pattern, kept in KEEPS.items() if fnmatch(path, pattern)), ())


def of_module(path: str) -> tuple[str, ...]:
    """Return what a module needs, by its path from the root of the repository."""
    return next((needs for pattern, needs in MODULES.items() if fnmatch(path, pattern)), ())


def is_astray(path: str) -> bool:
    """Whether no tier looks for tests that need something in a module."""
    return path.startswith("tests/") and not path.startswith(PLACES)


@cache
def missing(name: str) -> str:
    """Return why a need is not met, and what to do; empty when it is."""
    need = NEEDS[name]
    gone = need.lacking
    if not gone:
        return ""
    if not need.exists:
        return f"{gone}: not there for {platform.system()} on {platform.machine()}"
    return f"needs {gone}: {need.get}"


def refused(names: Iterator[str] | tuple[str, ...]) -> tuple[str, Callable[..., object]] | None:
    """Return the reason and whether to skip or to fail, or None where nothing is missing.

    Automation is to install every package that exists for its machine: there it is a failure.
    """
    for name in names:
        if reason := missing(name):
            need = NEEDS[name]
            fails = os.environ.get("CI") and need.exists and need.packages
            return reason, (pytest.fail if fails else pytest.skip)
    return None


def check(item: pytest.Item) -> None:
    """Skip a test that cannot be run here, with the reason; fail it where it must be."""
    names = (str(name) for mark in item.iter_markers("needs") for name in mark.args)
    if found := refused(names):
        reason, outcome = found
        outcome(reason)
