"""A visit that an agent leads, in plain words; a nurse approves what presses the arm.

The agent is a script that speaks the Model Context Protocol as a language model's client does, so
that no model is needed. `--approve` has the nurse approve by itself, over WebSocket; without it
the command is printed with which a person does.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import asyncio
import os
import sys
import tempfile
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import httpx2
from mcp.client.client import Client
from mcp.client.streamable_http import streamable_http_client

from uoarm import RobotManager
from uoarm.client import connect
from uoarm.server import ServerOptions, hash_token, make_token, serve_in_thread

FOLDER = Path(__file__).parent
ACCESS = """
version: 1
roles:
  agent: {{see: all, request: ["*"], call: ["*"], supervised: true}}
  nurse: {{see: all, approve: ["bloodPressure"], stop: all}}
tokens:
  - {{name: agent, role: agent, sha256: {agent}}}
  - {{name: tablet, principal: nurse, role: nurse, sha256: {nurse}}}
"""
PRESSURE = {"pressure": 160.0}


async def lead(client: Client, words: str) -> str:
    """Do what plain words ask for, as an agent would; return what the record gets."""
    print(f"patient: {words}", flush=True)
    await _use(client, "speech", {"text": "Good morning. Please put the clip on your finger."})
    read = await _use(client, "read_heartRate", {"seconds": 20})
    heart = read["messages"][0]
    asked = await _use(client, "bloodPressure", PRESSURE)
    assert asked["state"] == "approval-needed", "what presses an arm is never done at once"
    handle = asked["handle"]
    await _use(client, "speech", {"text": "I ask the nurse whether I may use the arm cuff."})
    while (decided := await _use(client, "wait", {"handle": handle}))["state"] == "pending":
        pass
    if decided["state"] != "approved":
        await _use(client, "speech", {"text": "The nurse does not want the cuff now. Thank you."})
        return f"pulse {heart['rate']}, SpO2 {heart['spo2']}; no blood pressure"
    done = await _use(client, "bloodPressure", {**PRESSURE, "x-approval": handle})
    found = done["result"]
    await _use(client, "speech", {"text": "Thank you. That is all for today."})
    pressure = f"{found['systolic']}/{found['diastolic']}"
    return f"pulse {heart['rate']}, SpO2 {heart['spo2']}, blood pressure {pressure}"


async def _use(client: Client, tool: str, arguments: dict[str, Any]) -> dict[str, Any]:
    result = await client.call_tool(tool, arguments)
    if result.is_error:
        raise RuntimeError(f"{tool}: {result.content}")
    facts: dict[str, Any] = result.structured_content
    return facts


async def approve_all(url: str, token: str) -> None:
    """Approve what comes, as the nurse."""
    async with connect(url, token=token) as robot:
        while True:
            for item in await robot.approvals():
                if item["phase"] == "pending":
                    await robot.approve(item["approval"], digest=item["digest"])
                    print(f"nurse: approved {item['arguments']}", flush=True)
            await asyncio.sleep(0.1)


async def visit(ports: tuple[int, ...], tokens: dict[str, str], *, approve: bool) -> str:
    """Lead one visit."""
    url = f"ws://127.0.0.1:{ports[0]}/"
    if not approve:
        print(f"in another terminal: export UOARM_TOKEN={tokens['nurse']}")
        print(f"  uoarm approve --url {url}            # what waits")
        print(f"  uoarm approve APPROVAL --url {url}   # approve it", flush=True)
    headers = {"Authorization": f"Bearer {tokens['agent']}"}
    async with httpx2.AsyncClient(headers=headers, timeout=60) as http:
        transport = streamable_http_client(f"http://127.0.0.1:{ports[1]}/mcp", http_client=http)
        async with Client(transport) as client:
            works: list[Coroutine[Any, Any, Any]] = [
                lead(client, "I would like to be measured, please.")
            ]
            if approve:
                works.append(approve_all(url, tokens["nurse"]))
            tasks = [asyncio.ensure_future(work) for work in works]
            ended, going = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in going:
                task.cancel()
            await asyncio.gather(*going, return_exceptions=True)
    # Not within the client, which makes a group of whatever is raised there.
    found: str = ended.pop().result()
    return found


def main() -> None:
    """Serve the robot, and lead one visit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--approve", action="store_true", help="the nurse approves by itself")
    given = parser.parse_args()
    sys.path.insert(0, str(FOLDER))
    tokens = {"agent": make_token(), "nurse": make_token()}
    hashes = {name: hash_token(token) for name, token in tokens.items()}
    with tempfile.TemporaryDirectory() as folder:
        access = Path(folder, "access.yaml")
        access.write_text(ACCESS.format(**hashes), encoding="utf-8")
        options = ServerOptions(port=0, access=access, front_end_ports={"mcp": 0})
        with (
            RobotManager.from_file(FOLDER / "robot.yaml") as robot,
            serve_in_thread(robot, options) as server,
        ):
            found = asyncio.run(visit(server.ports, tokens, approve=given.approve))
    print(f"record: {found}", flush=True)


if __name__ == "__main__":
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        main()
    except KeyboardInterrupt:
        sys.exit(130)
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
