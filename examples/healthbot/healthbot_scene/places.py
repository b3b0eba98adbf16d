"""Where the things of one run are: its folder, its ports on loopback, and its footage."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from pathlib import Path

from attrs import frozen
from uoarm_vision.photos import photos_in
from vision_demo.footage import prepare
from vision_demo.ports import free_domain, free_ports, listens

from healthbot_scene.crew import environment_of, fill_in_robot
from healthbot_scene.separate import HOSTS

__all__ = ["EXAMPLE", "Places", "make_places"]

EXAMPLE = Path(__file__).resolve().parents[1]
_RECOGNISERS = ("resnet", "lbph")


@frozen
class Places:
    """What differs from one run to the next.

    Attributes:
        run: folder of this run: lines, logs, queue of measurements, database.
        footage: folder with `playlist` and the `gallery` of the enrolled.
        domain: of ROS 2.
        names: port of the naming service.
        records: port of the records service.
        serve: port of `uoarm serve`.
        page: port of the browser application.
    """

    run: Path
    footage: Path
    domain: int
    names: int
    records: int
    serve: int
    page: int

    @property
    def movie(self) -> Path:
        """What the cameras play: the first of the playlist."""
        return min((self.footage / "playlist").iterdir())

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
        """Where the browser application is."""
        return f"http://127.0.0.1:{self.page}/?robot={self.robot_url}"

    @property
    def records_url(self) -> str:
        """Where the records service is."""
        return f"http://127.0.0.1:{self.records}/fhir"

    def environment(self) -> dict[str, str]:
        """Return the environment variables of every part: loopback only, our own domain."""
        paths = (EXAMPLE, EXAMPLE / "records", EXAMPLE.parent / "vision")
        return environment_of(self.run, self.domain, paths, EXAMPLE / "discovery.xml")

    def write_robot(self, template: Path, hosts: Mapping[str, str] | None = None) -> Path:
        """Fill a robot file in and leave it in the folder of the run.

        Args:
            template: the robot file, with names behind dollar signs.
            hosts: of bridges, by those names; None: processes of this Python.
        """
        words = {
            **dict.fromkeys(HOSTS, "true"),
            **(hosts or {}),
            "here": EXAMPLE,
            "run": self.run,
            "gallery": self.footage / "gallery",
            "movie": self.movie,
            "domain": self.domain,
            "names": self.nameserver,
            "records": self.records_url,
        }
        return fill_in_robot(template, words, self.run)


def make_places(
    run: Path,
    cache: Path,
    ports: tuple[int, int, int, int] | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> Places:
    """Fetch the footage, let the recognisers learn it, and choose ports and a ROS 2 domain.

    Args:
        run: a folder for this run; made if need be.
        cache: where footage is kept.
        ports: of naming, records, robot and page; None: four that are free.
        report: called with footage that others must stand in for.

    Raises:
        FootageError: footage cannot be had.
        OSError: another process listens on one of the ports.
    """
    for port in ports or ():
        if listens(port):
            raise OSError(
                f"port {port} is in use, perhaps by another scene; take others with "
                "make healthbot ARGS=--free-ports, or scene.py --free-ports"
            )
    run.mkdir(parents=True, exist_ok=True)
    footage = prepare(cache)
    if footage.remark:
        report(footage.remark)
    gallery = footage.folder / "gallery"
    for name in _RECOGNISERS:
        try:
            recogniser = importlib.import_module(f"uoarm_vision.{name}")
        except ImportError:
            continue  # its component says what to install when it is asked for
        try:
            recogniser.enrol(photos_in(footage.photos), gallery)
        except ValueError as error:
            report(f"The {name} recogniser knows no one: {error}")
    first, second, third, fourth = ports or free_ports(4)
    return Places(
        run.resolve(), footage.folder.resolve(), free_domain(), first, second, third, fourth
    )
