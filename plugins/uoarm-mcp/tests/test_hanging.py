"""What an agent moves stops with its lifetime, whichever process hangs: its own or the manager."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest
from agents import TOKENS, Agents

from uoarm.testing import patience, wait

BASE = """
import pathlib
from typing import TypedDict

TAKEN = pathlib.Path(__file__).with_name("taken")


class Speed(TypedDict):
    speed: float


def drive(message: Speed) -> None:
    with TAKEN.open("a") as taken:
        taken.write(f"{message['speed']}\\n")
"""
CONFIGURATION = """
version: 1
bridges: {base: {plugin: python, host: true}}
functions:
  drive:
    components:
      - name: base
        bridge: base
        input:
          endpoint: ["base:drive"]
          lifetime: 0.5
          stop: {message: {speed: 0.0}}
"""
# An agent that asks for many commands within a minute, and gives one after the other.
AGENT = """
import asyncio
import sys

import httpx2
from mcp.client.client import Client
from mcp.client.streamable_http import streamable_http_client

URL, TOKEN = sys.argv[1:]


async def main() -> None:
    headers = {"Authorization": f"Bearer {TOKEN}"}
    async with httpx2.AsyncClient(headers=headers, timeout=600) as http:
        async with Client(streamable_http_client(URL, http_client=http)) as client:
            plan = {"function": "drive", "operation": "send", "arguments": {"speed": 1.0},
                    "envelope": {"count": 1000}, "seconds": 3600}
            asked = await client.call_tool("plan", plan)
            handle = asked.structured_content["handle"]
            print(handle, flush=True)
            while True:
                state = await client.call_tool("wait", {"handle": handle, "seconds": 30})
                if state.structured_content["state"] == "approved":
                    break
            while True:
                await client.call_tool("send_drive", {"speed": 1.0, "x-approval": handle})
                await asyncio.sleep(0.05)


asyncio.run(main())
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "base.py").write_text(BASE, encoding="utf-8")
    (tmp_path / "robot.yaml").write_text(CONFIGURATION, encoding="utf-8")
    return tmp_path


@contextmanager
def running(*words: str, errors: IO[str] | None = None) -> Iterator[subprocess.Popen[str]]:
    """Run a program in a process; end it though it stands."""
    process = subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, stderr=errors, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def taken(folder: Path) -> list[str]:
    path = folder / "taken"
    return path.read_text("utf-8").split() if path.exists() else []


def ports_of(path: Path) -> tuple[int, ...]:
    return tuple(int(port) for port in re.findall(r"serving \w+://[^:]+:(\d+)/", path.read_text()))


@pytest.mark.parametrize("hangs", ["agent", "manager"])
def test_what_moves_stops_though_a_process_hangs(folder: Path, access: Path, hangs: str) -> None:
    log = folder / "log"
    words = ["mcp", str(folder / "robot.yaml"), "--access", str(access), "--http", "0"]
    with (
        log.open("w", encoding="utf-8") as errors,
        running("-m", "uoarm", *words, "--port", "0", errors=errors) as manager,
    ):
        wait(lambda: len(ports_of(log)) == 2, "it serves")
        with (
            Agents(ports_of(log), TOKENS) as people,
            running("-c", AGENT, people.url, TOKENS["agent"], errors=errors) as agent,
        ):
            assert agent.stdout is not None
            people.approve(agent.stdout.readline().strip())
            wait(lambda: taken(folder).count("1.0") > 3, "it moves")
            standing = {"agent": agent, "manager": manager}[hangs]
            os.kill(standing.pid, signal.SIGSTOP)
            try:
                wait(lambda: taken(folder)[-1] == "0.0", "it stops")
            finally:
                os.kill(standing.pid, signal.SIGCONT)
            manager.terminate()
            assert manager.wait(patience()) == 0
