"""The parts of the scene: which program each is, and how one sees that it is ready."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from uoarm_rtm.nameserver import nameserver_command
from vision_demo.ports import listens

from healthbot_scene.crew import Part
from healthbot_scene.places import Places

__all__ = ["parts_of"]

_PYTHON = sys.executable
_DEVICES = ("uoarm-rocos", "simulate")


def parts_of(places: Places, robot: Path, page: Path) -> list[Part]:
    """Return the parts in the order in which they are started.

    Args:
        places: of this run.
        robot: the robot file, filled in.
        page: folder of the browser application.
    """
    run = places.run
    records = (*_module("healthbot_records", "--port"), str(places.records))
    server = (*_tool("uoarm", "serve"), str(robot), "--port", str(places.serve))
    origin = f"http://127.0.0.1:{places.page}"
    pages = (*_module("healthbot_scene.pages", str(page)), str(places.page))
    return [
        Part("naming", "the naming service", "OpenRTM", _naming(places), _listens(places.names)),
        Part(
            "detector",
            "face detection, an RT-Component",
            "OpenRTM",
            _module("healthbot_scene.rtm_detector", places.nameserver),
            _says("ready"),
        ),
        Part(
            "camera",
            f"camera, plays {places.movie.name}",
            "ROS 2",
            _module("healthbot_scene.ros_camera", str(places.movie)),
            _says("ready"),
        ),
        _oximeter("clip", "finger clip, simulated", "ROCOS profile", run, "contec"),
        _cuff("cuff", "arm cuff, simulated", "ROCOS profile", run),
        _oximeter("spare-clip", "second finger clip, simulated", "plain Python", run, "nonin-1"),
        _cuff("spare-cuff", "second arm cuff, simulated", "plain Python", run),
        Part(
            "records",
            "medical records, FHIR over HTTP",
            "web service",
            (*records, "--database", str(run / "records.sqlite")),
            _says("records at"),
        ),
        Part(
            "robot",
            f"uoarm serve at {places.robot_url}",
            "uoarm",
            (*server, "--origin", origin),
            _says("serving"),
            vital=True,
        ),
        Part(
            "page",
            f"browser application at {places.page_url}",
            "web page",
            pages,
            _listens(places.page),
        ),
    ]


def _naming(places: Places) -> tuple[str, ...]:
    """Return omniNames on loopback, which keeps its names should it be started again."""
    names = places.run / "names"
    names.mkdir(exist_ok=True)
    errors = str(names / "errors")
    command: tuple[str, ...] = nameserver_command(places.names, "127.0.0.1", names, errors)
    return command


def _oximeter(name: str, what: str, framework: str, run: Path, kind: str) -> Part:
    line = ("--pty", "--link", str(run / name), "--format", kind)
    return Part(name, what, framework, (*_tool(*_DEVICES, "oximeter"), *line), _says(name))


def _cuff(name: str, what: str, framework: str, run: Path) -> Part:
    line = ("--pty", "--link", str(run / name), "--interval", "4")
    return Part(name, what, framework, (*_tool(*_DEVICES, "blood-pressure"), *line), _says(name))


def _module(name: str, *arguments: str) -> tuple[str, ...]:
    return (_PYTHON, "-m", name, *arguments)


def _tool(name: str, *arguments: str) -> tuple[str, ...]:
    """Return a command that stands beside this Python."""
    return (str(Path(_PYTHON).with_name(name)), *arguments)


def _says(word: str) -> Callable[[Path], bool]:
    return lambda log: word in log.read_text(errors="replace")


def _listens(port: int) -> Callable[[Path], bool]:
    return lambda _: listens(port)
