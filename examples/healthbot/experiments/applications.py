"""The two applications, run as they are, for the experiments that need them."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Any

from attrs import frozen
from stage import EXAMPLE, ROOT

sys.path.insert(0, str(ROOT))

from healthbot_scene.needs import node
from tests.server.browser import Browser, find_chromium

__all__ = ["Visit", "browser_visit", "terminal_visit"]

_SECONDS = 180.0
_STEPS = (
    ("Hello", "Start"),
    ("Put your finger", "My finger is in"),
    ("Put the cuff", "The cuff is on"),
)
_PROMPT = "(document.getElementById('prompt')?.textContent ?? '')"


@frozen
class Visit:
    """How a visit went.

    Attributes:
        greeting: what the application said first to the person.
        outcome: what became of the measurements, or why there are none.
        seconds: how long it took.
    """

    greeting: str
    outcome: str
    seconds: float


async def terminal_visit(robot: str) -> Visit:
    """Run the terminal application once."""
    program = node()
    if program is None:
        return Visit("", "not run: Node.js 20.10 or later is not installed", 0.0)
    begun = time.monotonic()
    flags = ("--experimental-websocket", "--no-warnings")
    process = await asyncio.create_subprocess_exec(
        program,
        *flags,
        str(EXAMPLE / "terminal" / "main.mjs"),
        robot,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    try:
        report, _ = await asyncio.wait_for(process.communicate(), _SECONDS)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    lines = report.decode().splitlines()
    spoken = [line.partition(" ")[2].strip() for line in lines if line.startswith("robot")]
    measured = [" ".join(line.split()) for line in lines if line.startswith("  ")]
    outcome = f"exit code {process.returncode}; {'; '.join(measured)}"
    return Visit(spoken[0] if spoken else "", outcome, time.monotonic() - begun)


async def browser_visit(page: str) -> Visit:
    """Run the browser application once, in headless Chromium."""
    program = find_chromium()
    if program is None:
        return Visit("", "not run: chromium is not installed", 0.0)
    return await asyncio.to_thread(_browse, program, page)


def _browse(program: str, page: str) -> Visit:
    begun = time.monotonic()
    with Browser(program) as browser:
        browser.show(1280, 800)
        browser.go(page)
        greeting = ""
        for prompt, label in _STEPS:
            greeting = greeting or _shown(browser, prompt)
            _shown(browser, prompt)
            browser.click("#choices button", label)
        _shown(browser, "Thank you")
        values: Any = browser.js("document.getElementById('values').innerText")
    return Visit(greeting, " ".join(str(values).split()), time.monotonic() - begun)


def _shown(browser: Browser, beginning: str) -> str:
    """Wait for a prompt and return it."""
    so = f"{_PROMPT}.startsWith({json.dumps(beginning)}) && {_PROMPT}"
    return str(browser.until(so))
