"""The parts of the scene, and where the things of one run are."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from attrs import frozen
from healthbot_scene.crew import Part, environment_of, fill_in_robot
from vision_demo.ports import free_domain, free_ports, listens

__all__ = [
    "EXAMPLE",
    "NEEDS",
    "NEWCOMER_HOME",
    "Places",
    "make_places",
    "missing",
    "newcomer",
    "parts_of",
]

NEWCOMER_HOME: Final = "home4"

EXAMPLE: Final = Path(__file__).resolve().parents[1]
_PYTHON: Final = sys.executable
NEEDS: Final = {
    "rclpy": "ROS 2", "test_msgs": "ROS 2", "omniORB": "OpenRTM", "uoarm_ros2": "ROS 2",
    "uoarm_rtm": "OpenRTM", "uoarm_rocos": "the station", "uoarm_vda5050": "VDA 5050",
    "websockets": "the server",
    "msgpack": "hosts",
}  # fmt: skip


@frozen
class Places:
    """What differs from one run to the next.

    Attributes:
        run: folder of this run: logs and journals.
        domain: of ROS 2.
        names: port of the naming service.
        floor: UDP port of the simulator.
        serve: port of `uoarm serve`.
        page: port of the page.
        broker: port of the MQTT broker.
    """

    run: Path
    domain: int
    names: int
    floor: int
    serve: int
    page: int
    broker: int

    @property
    def nameserver(self) -> str:
        """Address of the naming service."""
        return f"corbaloc:iiop:127.0.0.1:{self.names}/NameService"

    @property
    def robot_url(self) -> str:
        """Where applications find the robot."""
        return f"ws://127.0.0.1:{self.serve}/"

    @property
    def page_url(self) -> str:
        """Where the page is."""
        return f"http://127.0.0.1:{self.page}/?robot={self.robot_url}"

    @property
    def broker_url(self) -> str:
        """Where the MQTT broker is."""
        return f"mqtt://127.0.0.1:{self.broker}"

    def environment(self) -> dict[str, str]:
        """Return the environment variables of every part: loopback only, our own domain."""
        paths = (EXAMPLE, EXAMPLE.parent / "healthbot", EXAMPLE.parent / "vision")
        common = environment_of(self.run, self.domain, paths, EXAMPLE / "discovery.xml")
        return {**common, "WAREHOUSE_FLOOR": str(self.floor)}

    def write_robot(self, template: Path) -> Path:
        """Fill a robot file in and leave it in the folder of the run."""
        words = {
            "here": EXAMPLE,
            "run": self.run,
            "domain": self.domain,
            "names": self.nameserver,
            "broker": self.broker_url,
        }
        return fill_in_robot(template, words, self.run)


def make_places(run: Path) -> Places:
    """Choose ports and a ROS 2 domain that are free, and make the folder."""
    run.mkdir(parents=True, exist_ok=True)
    names, floor, serve, page, broker = free_ports(5)
    return Places(run.resolve(), free_domain(), names, floor, serve, page, broker)


def missing() -> list[str]:
    """Return what is not here, and how to get it."""
    lacking = [
        f"the Python module {module} ({what}) is not here: `make warehouse` installs it"
        for module, what in NEEDS.items()
        if find_spec(module) is None
    ]
    if _mosquitto() is None:
        lacking.append("mosquitto, the MQTT broker, is not here: Debian: apt install mosquitto")
    return lacking


def _mosquitto() -> str | None:
    """Return the broker; Debian has it where only root looks for programs."""
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")


def _broker(places: Places) -> tuple[str, ...]:
    """Return the broker on loopback, which keeps nothing.

    It stays the user who starts it, which root has to say, whatever USER says: one that becomes
    another is not ended with its parent.
    """
    user = "user root\n" if os.geteuid() == 0 else ""
    file = places.run / "mosquitto.conf"
    file.write_text(
        f"listener {places.broker} 127.0.0.1\nallow_anonymous true\npersistence false\n"
        f"set_tcp_nodelay true\n{user}"
    )
    return (_mosquitto() or "mosquitto", "-c", str(file))


def parts_of(places: Places, robot: Path) -> list[Part]:
    """Return the parts in the order in which they are started.

    Args:
        places: of this run.
        robot: the robot file, filled in.
    """
    from uoarm_rtm.nameserver import nameserver_command  # noqa: PLC0415 - where it is installed

    names = places.run / "names"
    names.mkdir(exist_ok=True)
    naming = nameserver_command(places.names, "127.0.0.1", names, str(names / "errors"))
    server = (str(Path(_PYTHON).with_name("uoarm")), "serve", str(robot))
    origin = f"http://127.0.0.1:{places.page}"
    ready = _says("ready")
    return [
        Part("naming", "the naming service", "OpenRTM", naming, _listens(places.names)),
        Part("broker", "Mosquitto", "MQTT", _broker(places), _listens(places.broker)),
        Part("floor", "the simulator", "", _module("warehouse_floor", str(places.floor)), ready),
        Part(
            "amr",
            "a mobile robot with an action server",
            "ROS 2",
            _module("warehouse_vehicles.ros_amr", "amr", "home1"),
            ready,
        ),
        Part(
            "cart",
            "a cart, an RT-Component",
            "OpenRTM",
            _module("warehouse_vehicles.rtm_cart", "cart", "home2", places.nameserver),
            ready,
        ),
        Part(
            "agv",
            "an automated vehicle, release 2.1",
            "VDA 5050",
            _module("warehouse_vehicles.vda_agv", "agv", "home3", places.broker_url, "2.1"),
            ready,
        ),
        Part(
            "station",
            "a scale and a lamp on a serial line",
            "XML device",
            _module(
                "warehouse_station", str(places.run / "station"), str(places.run / "placed.jsonl")
            ),
            ready,
        ),
        Part(
            "robot",
            f"uoarm serve at {places.robot_url}",
            "uoarm",
            (*server, "--port", str(places.serve), "--origin", origin),
            _says("serving"),
            vital=True,
        ),
        Part(
            "orders",
            "the application that gives out orders",
            "",
            _module("warehouse_orders", places.robot_url, str(places.run)),
            ready,
        ),
        Part(
            "page",
            f"the floor at {places.page_url}",
            "web page",
            _module("healthbot_scene.pages", str(EXAMPLE / "browser"), str(places.page)),
            _listens(places.page),
        ),
    ]


def newcomer(places: Places) -> Part:
    """Return a fourth vehicle, of release 3.0, which no configuration names and no scene starts."""
    return Part(
        "visitor",
        "an automated vehicle, release 3.0",
        "VDA 5050",
        _module("warehouse_vehicles.vda_agv", "visitor", NEWCOMER_HOME, places.broker_url, "3.0"),
        _says("ready"),
    )


def _module(name: str, *arguments: str) -> tuple[str, ...]:
    return (_PYTHON, "-m", name, *arguments)


def _says(word: str) -> Callable[[Path], bool]:
    return lambda log: word in log.read_text(errors="replace")


def _listens(port: int) -> Callable[[Path], bool]:
    return lambda _: listens(port)
