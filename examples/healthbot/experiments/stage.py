"""What the experiments share: a running scene, the machine's size, and tables in Markdown."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from attrs import frozen

EXAMPLE = Path(__file__).resolve().parents[1]
ROOT = EXAMPLE.parents[1]
sys.path[:0] = [str(EXAMPLE), str(EXAMPLE.parent / "vision")]

from healthbot_scene.crew import (  # noqa: E402 - found once the path is set
    Crew,
    Part,
    end_in_silence,
    host_of,
)

sys.excepthook = end_in_silence

from healthbot_scene.parts import parts_of  # noqa: E402
from healthbot_scene.places import Places, make_places  # noqa: E402
from vision_demo.ports import free_domain  # noqa: E402

__all__ = [
    "EXAMPLE",
    "ROOT",
    "Stage",
    "free_domain",
    "head",
    "host_of",
    "load",
    "machine",
    "record",
    "stage",
    "table",
    "writable",
]


@frozen
class Stage:
    """A running scene.

    Attributes:
        crew: its parts.
        places: where they are.
        parts: by name, to start one again.
    """

    crew: Crew
    places: Places
    parts: dict[str, Part]


@contextmanager
def stage(robot: str = "robot.yaml") -> Iterator[Stage]:
    """Start the scene with a robot file of the example; end it at the end.

    Raises:
        PartError: a part could not be started.
    """
    cache = Path(os.environ.get("UOARM_CACHE", ROOT / ".cache")) / "vision"
    with tempfile.TemporaryDirectory(prefix="healthbot-") as run:
        places = make_places(Path(run), cache)
        parts = parts_of(places, places.write_robot(EXAMPLE / robot), EXAMPLE / "browser")
        with Crew(places.run, places.environment()) as crew:
            crew.start_all(parts, lambda _: None)
            yield Stage(crew, places, {part.name: part for part in parts})


def load() -> float:
    """Return how many programs wanted to run in the last minute, on average."""
    return os.getloadavg()[0]


def machine(before: float | None = None) -> str:
    """Return when this is, on what, and how busy it is, in words.

    Args:
        before: the load when the measurement began.
    """
    busy = f"load {load():.1f}" if before is None else f"load {before:.1f} to {load():.1f}"
    now = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    size = f"{os.cpu_count()} cores, {busy}"
    system = f"{platform.system()} {platform.machine()}"
    return f"{now}, {size}, {system}, CPython {platform.python_version()}"


def head(title: str) -> None:
    """Print what was measured, when and on what."""
    print(f"{title}, {machine()}\n")


def writable(given: str) -> Path:
    """Return the path of an option; raises what argparse says where no file can be written there.

    Before anything is measured: that takes minutes.
    """
    try:
        Path(given).open("a", encoding="utf-8").close()
    except OSError as error:
        text = f"{given} cannot be written: {error.strerror}"
        raise argparse.ArgumentTypeError(text) from error
    return Path(given)


def record(file: Path, measured: str, figures: Sequence[Mapping[str, Any]]) -> None:
    """Write figures as JSON, for plots.

    Args:
        file: written anew.
        measured: when and on what.
        figures: each a mapping of plain values.
    """
    reports = {"measured": measured, "figures": figures}
    file.write_text(json.dumps(reports, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    for row in (header, ["---"] * len(header), *rows):
        print(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |")
    print(flush=True)
