"""What the experiments share: the running scene, their options, and tables."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

import yaml
from attrs import field, frozen

EXAMPLE: Final = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(EXAMPLE), str(EXAMPLE.parent / "healthbot"), str(EXAMPLE.parent / "vision")]

from healthbot_scene.crew import (  # noqa: E402 - found once the path is set
    Crew,
    Part,
    end_in_silence,
)

sys.excepthook = end_in_silence

from warehouse_floor.link import FloorLink  # noqa: E402
from warehouse_scene.parts import Places, make_places, parts_of  # noqa: E402

__all__ = [
    "EXAMPLE",
    "FRAMEWORKS",
    "VEHICLES",
    "Row",
    "Stage",
    "Tables",
    "figures",
    "options",
    "progress",
    "stage",
]

VEHICLES: Final = ("amr", "cart", "agv")
FRAMEWORKS: Final = {"amr": "ROS 2", "cart": "OpenRTM", "agv": "VDA 5050"}

_FEW: Final = 2

Row = Mapping[str, object]


@frozen
class Stage:
    """A running scene.

    Attributes:
        crew: its parts.
        places: where they are.
        parts: by name, to start one again.
        link: to the simulator, for the thread of the experiment.
    """

    crew: Crew
    places: Places
    parts: dict[str, Part]
    link: FloorLink


@contextmanager
def stage(
    without: Sequence[str] = (),
    change: Callable[[dict[str, Any]], dict[str, Any]] | None = None,
) -> Iterator[Stage]:
    """Start the scene; end it at the end.

    Args:
        without: parts that are not started.
        change: makes another robot of the content of the scene's file.

    Raises:
        PartError: a part could not be started.
    """
    with tempfile.TemporaryDirectory(prefix="warehouse-") as folder:
        places = make_places(Path(folder))
        file = places.write_robot(EXAMPLE / "robot.yaml")
        if change is not None:
            robot = change(yaml.safe_load(file.read_text()))
            file.write_text(json.dumps(robot))  # each JSON text is one of YAML
        parts = parts_of(places, file)
        with Crew(places.run, places.environment()) as crew, FloorLink(places.floor) as link:
            crew.start_all([part for part in parts if part.name not in without], lambda _: None)
            yield Stage(crew, places, {part.name: part for part in parts}, link)


@frozen
class Tables:
    """What an experiment found: tables with a title each, and when and under what load.

    Attributes:
        as_json: whether it is printed as one object of JSON.
    """

    as_json: bool = False
    _begun: float = field(factory=lambda: os.getloadavg()[0])
    _tables: dict[str, Sequence[Row]] = field(factory=dict)

    def add(self, title: str, rows: Sequence[Row]) -> None:
        """Take a table; each row has the same keys, which are its head."""
        self._tables[title] = rows

    def print(self) -> None:
        """Print all of them."""
        now = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
        load = [round(self._begun, 1), round(os.getloadavg()[0], 1)]
        if self.as_json:
            reports = {
                "measured": now,
                "cores": os.cpu_count(),
                "load": load,
                "tables": self._tables,
            }
            print(json.dumps(reports, indent=1, ensure_ascii=False))
            return
        print(f"{now}, {os.cpu_count()} cores, load {load[0]} to {load[1]}")
        for title, rows in self._tables.items():
            print(f"\n{title}\n")
            cells = [
                list(rows[0]),
                ["---"] * len(rows[0]),
                *(map(str, mapping.values()) for mapping in rows),
            ]
            for row in cells:
                print(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |")


def options(text: str | None, **numbers: float) -> Any:
    """Return the options of an experiment: `--json`, and a number each.

    Args:
        text: for the help.
        numbers: what they are when they are not given.
    """
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print one object of JSON")
    for name, usual in numbers.items():
        parser.add_argument(f"--{name}", type=type(usual), default=usual, help=f"usual: {usual:g}")
    return parser.parse_args()


def figures(seconds: Sequence[float]) -> Row:
    """Return cells of a table: how many, and in milliseconds median, 99th percentile, longest."""
    found = sorted(1000 * value for value in seconds)
    if len(found) < _FEW:
        return {"times": len(found), "median ms": "", "p99 ms": "", "longest ms": ""}
    return {
        "times": len(found),
        "median ms": round(statistics.median(found)),
        "p99 ms": round(statistics.quantiles(found, n=100, method="inclusive")[98]),
        "longest ms": round(found[-1]),
    }


def progress(line: object) -> None:
    """Notify what waits."""
    print(line, file=sys.stderr, flush=True)
