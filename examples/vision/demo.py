"""The paper's example on real footage: ask for faceRecognition, see who is seen."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
from footage import Footage, FootageError, fetch
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import uoarm
from uoarm import OverflowPolicy, QueuePolicy, RobotManager
from uoarm.config import loads
from uoarm.resolve import tell_plan

HERE = Path(__file__).resolve().parent
EXPECTED = {"franck.mp4": "franck", "carphone.mp4": "unknown", "obama-photos": "obama"}
FRAMES = 40 + 40 + 2


def main() -> int:
    """Run the demonstration; return 0 when everybody was recognised for who they are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--light", action="store_true", help="do without dlib")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--output", type=Path, default=Path("demo-output"))
    options = parser.parse_args()
    console = Console(stderr=options.json)
    try:
        with console.status("fetching footage ...") as status:
            footage = fetch(lambda what: status.update(f"fetching {what} ..."))
        result = _run(footage, console, options.output, light=options.light)
    except FootageError as error:
        console.print(f"[red]error:[/] {error}")
        return 4
    except uoarm.UoarmError as error:
        console.print(f"[red]error:[/] {error}")
        return 1
    except KeyboardInterrupt:
        console.print("interrupted; everything was closed")
        return 130
    if options.json:
        print(json.dumps(result, indent=2))
    return 0 if result["recognised"] else 1


def _run(footage: Footage, console: Console, output: Path, *, light: bool) -> dict[str, Any]:
    seen: dict[str, Counter[str]] = {name: Counter() for name in EXPECTED}
    configuration = _configuration(footage, light=light)
    with RobotManager(loads(configuration, str(HERE / "robot.yaml"))) as robot:
        plan = robot.resolve("faceRecognition")
        console.print(tell_plan(plan), highlight=False)
        wait = QueuePolicy(8, OverflowPolicy.BLOCK, 60)
        with (
            Progress(console=console) as progress,
            robot.request("faceRecognition", validate="sampled", queue=wait) as people,
        ):
            task = progress.add_task("recognising", total=FRAMES)
            picture = None
            routes = robot.status().routes
            for message in people:
                for person in message["people"]:
                    seen[message["frame"]["source"]][person["name"]] += 1
                    if person["name"] == "obama":
                        picture = message
                progress.advance(task)
                routes = robot.status().routes or routes
    file = _annotate(picture, output) if picture is not None else None
    drops = sum(count for route in routes for _, count in route.dropped)
    _show(console, seen, routes, drops, file)
    return {
        "plan": [step.component.name for step in plan.steps],
        "seen": {source: dict(counts) for source, counts in seen.items()},
        "dropped": drops,
        "picture": None if file is None else str(file),
        "recognised": all(
            bool(counts) and counts.most_common(1)[0][0] == EXPECTED[source]
            for source, counts in seen.items()
        ),
    }


def _configuration(footage: Footage, *, light: bool) -> str:
    """Return robot.yaml with this machine's footage filled in."""
    text = (HERE / "robot.yaml").read_text(encoding="utf-8")
    paths = json.dumps([str(path) for path in footage.played])
    text = text.replace('paths: ["0"]', f"paths: {paths}")
    text = text.replace("people: people", f"people: {json.dumps(str(footage.people))}")
    return text.replace("priority: 10", "priority: 1") if light else text


def _annotate(message: Any, folder: Path) -> Path:
    """Write a picture with a box and a name for each face."""
    from uoarm_vision.messages import pixels_of  # noqa: PLC0415 - found once the robot is loaded

    picture = pixels_of(message["frame"]).copy()
    for person in message["people"]:
        box = person["box"]
        corner = (box["left"], box["top"])
        cv2.rectangle(picture, corner, (box["right"], box["bottom"]), (0, 200, 0), 2)
        cv2.putText(picture, person["name"], (corner[0], corner[1] - 6),
                    cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 200, 0), 2)  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "recognised.png"
    cv2.imwrite(str(file), picture)
    return file


def _show(console: Console, seen: Any, routes: Any, drops: int, file: Path | None) -> None:
    who = Table("footage", "seen as", "faces", "expected", title="who was seen")
    for source, counts in seen.items():
        for name, count in counts.most_common():
            who.add_row(source, name, str(count), EXPECTED[source])
    console.print(who)
    status = Table("from", "to", "received", "delivered", title="live status, last look")
    for route in routes:
        status.add_row(route.producer, route.consumer, str(route.received), str(route.delivered))
    console.print(status)
    console.print(f"dropped: {drops}" + (f"; annotated picture: {file}" if file else ""))


if __name__ == "__main__":
    sys.exit(main())
