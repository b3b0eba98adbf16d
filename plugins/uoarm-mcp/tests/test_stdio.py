"""`uoarm mcp` as a client starts it: on standard input and output, with a token of its own."""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from agents import TOKENS, text_of
from components import CONFIGURATION
from mcp.client.client import Client
from mcp.client.stdio import StdioServerParameters, stdio_client

from uoarm.client import connect
from uoarm.testing import patience

FOLDER = Path(__file__).parent


async def _with(
    folder: Path, access: Path, token: str, act: Any, mode: str = "auto"
) -> tuple[Any, str]:
    configuration = folder / "robot.yaml"
    configuration.write_text(CONFIGURATION, encoding="utf-8")
    audit = folder / "audit.jsonl"
    words = ["mcp", str(configuration), "--port", "0", "--access", str(access)]
    parameters = StdioServerParameters(
        command=sys.executable,
        args=["-m", "uoarm", *words, "--audit", str(audit)],
        env={**os.environ, "UOARM_TOKEN": token, "PYTHONPATH": str(FOLDER)},
    )
    with tempfile.TemporaryFile("w+", dir=folder) as errors:
        transport = stdio_client(parameters, errlog=errors)
        async with Client(transport, mode=mode, read_timeout_seconds=patience()) as client:
            errors.seek(0)
            found = re.search(r"serving (ws://\S+)", errors.read())
            assert found is not None
            answer = await act(client, found[1])
    return answer, audit.read_text(encoding="utf-8")


def test_an_agent_asks_and_a_person_approves_over_websocket(tmp_path: Path, access: Path) -> None:
    async def act(client: Client, url: str) -> list[Any]:
        asked = await client.call_tool("cuff", {"pressure": 90.0})
        handle = asked.structured_content["handle"]
        async with connect(url, token=TOKENS["nurse"]) as nurse:
            await nurse.approve(handle)
        done = await client.call_tool("cuff", {"pressure": 90.0, "x-approval": handle})
        again = await client.call_tool("cuff", {"pressure": 90.0, "x-approval": handle})
        return [done.structured_content["result"], text_of(again)]

    (result, refusal), audit = asyncio.run(_with(tmp_path, access, TOKENS["agent"], act))
    assert result == {"value": 90}
    assert "is used" in refusal
    lines = [json.loads(line) for line in audit.splitlines()]
    phases = [line["phase"] for line in lines if "phase" in line]
    assert phases == ["pending", "approved", "used"]
    assert [line["refused"] for line in lines if "requester" in line and "refused" in line]
    assert (tmp_path / "audit.jsonl").stat().st_mode & 0o777 == 0o600


def test_the_revision_before_speaks_there_too(tmp_path: Path, access: Path) -> None:
    async def act(client: Client, url: str) -> Any:
        del url
        return (await client.call_tool("add", {"a": 1, "b": 2})).structured_content["result"]

    result, _ = asyncio.run(_with(tmp_path, access, TOKENS["agent"], act, "legacy"))
    assert result == {"value": 3}
