"""Heterogeneous applications: programs in Python and JavaScript use the same vehicles at once.

    python examples/warehouse/experiments/clients.py

A Python program, a terminal program for Node.js and, where Chromium is installed, the page place
orders at the same time, each in its own language and over its own connection. Prints a table.
"""

from __future__ import annotations

import asyncio
import re
import shutil
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any, Final

from experiment import EXAMPLE, Row, Stage, Tables, options, progress, stage

from uoarm.client import connect

sys.path.insert(0, str(EXAMPLE.parents[1]))

from tests.server.browser import Browser, find_chromium

_SOURCES: Final = ("shelf1", "shelf2", "shelf3")
_SECONDS: Final = 400.0
_LINE: Final = re.compile(r"(?P<order>\S+): done (?P<vehicle>\S+)")

Finished = tuple[str, float]


async def in_python(scene: Stage) -> list[Finished]:
    """Place orders as a Python program does; return which vehicle did each, and when."""
    begun = time.monotonic()
    found: list[Finished] = []
    async with connect(scene.places.robot_url) as robot:
        pictures = await robot.request("floor")
        names = [f"python-{int(time.time())}-{number}" for number in range(len(_SOURCES))]
        for name, source in zip(names, _SOURCES, strict=True):
            await robot.call(
                "transport", {"order": name, "source": source, "target": "", "load": 5.0}
            )
        async for picture in pictures:
            for order in picture["orders"]:
                if order["order"] in names and order["status"] == "done":
                    names.remove(order["order"])
                    found.append((order["vehicle"], time.monotonic() - begun))
            if not names:
                break
    return found


async def in_terminal(scene: Stage) -> list[Finished]:
    """Run the terminal program for Node.js."""
    node = shutil.which("node")
    if node is None:
        return []
    begun = time.monotonic()
    process = await asyncio.create_subprocess_exec(
        node,
        "--experimental-websocket",
        "--no-warnings",
        str(EXAMPLE / "terminal" / "main.mjs"),
        scene.places.robot_url,
        *(f"{source}:5" for source in _SOURCES),
        stdout=asyncio.subprocess.PIPE,
    )
    found: list[Finished] = []
    try:
        assert process.stdout is not None
        async for line in process.stdout:
            matches = _LINE.finditer(line.decode())
            found.extend((match["vehicle"], time.monotonic() - begun) for match in matches)
        await process.wait()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return found


async def in_browser(scene: Stage) -> list[Finished]:
    """Place orders with the form of the page, in headless Chromium."""
    program = find_chromium()
    if program is None:
        return []
    return await asyncio.to_thread(_browse, program, scene.places.page_url)


def _browse(program: str, page: str) -> list[Finished]:
    found: dict[str, Finished] = {}
    with Browser(program) as browser:
        browser.show(1280, 860)
        browser.go(page)
        browser.until("document.querySelectorAll('#vehicles tr').length >= 3")
        begun = time.monotonic()
        for source in _SOURCES:
            browser.js(f"document.querySelector('[name=source]').value = {source!r}")
            browser.js("document.querySelector('#place').requestSubmit()")
            time.sleep(1.0)
        while len(found) < len(_SOURCES) and time.monotonic() < begun + _SECONDS:
            rows = "[...document.querySelectorAll('#orders tr')].map(one => one.innerText)"
            for text in browser.js(rows):
                order, *_, status, vehicle = text.split("\t")
                if status == "done" and order.startswith("page-") and order not in found:
                    found[order] = (f"transport{vehicle}", time.monotonic() - begun)
            time.sleep(0.3)
    return list(found.values())


PROGRAMS: Final[dict[str, Callable[[Stage], Awaitable[list[Finished]]]]] = {
    "program, Python": in_python,
    "terminal, JavaScript on Node.js": in_terminal,
    "page, JavaScript in Chromium": in_browser,
}


async def run(scene: Stage) -> list[Row]:
    """Have all of them place their orders at once."""
    work = [asyncio.wait_for(program(scene), _SECONDS) for program in PROGRAMS.values()]
    ended: list[Any] = await asyncio.gather(*work, return_exceptions=True)
    found: list[Row] = []
    for name, done in zip(PROGRAMS, ended, strict=True):
        if isinstance(done, BaseException):
            progress(f"{name}: {done!r}")
        orders = [] if isinstance(done, BaseException) else done
        vehicles = sorted({vehicle.removeprefix("transport") for vehicle, _ in orders})
        found.append(
            {
                "application": name,
                "orders done": f"{len(orders)} of {len(_SOURCES)}",
                "vehicles that it had": ", ".join(vehicles),
                "seconds to the last": round(max((at for _, at in orders), default=0.0)),
            }
        )
    return found


def main() -> int:
    """Run it and print the table."""
    chosen = options(__doc__)
    tables = Tables(chosen.json)
    with stage() as scene:
        found = asyncio.run(run(scene))
        truth = scene.link.ask()
    tables.add(f"Heterogeneous applications; collisions: {truth['collisions']}", found)
    tables.print()
    wanted = f"{len(_SOURCES)} of {len(_SOURCES)}"
    return 0 if all(row["orders done"] == wanted for row in found) else 1


if __name__ == "__main__":
    sys.exit(main())
