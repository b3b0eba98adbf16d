"""The protocol's own client library, unmodified, in Node.js.

npm brings it, unless UOARM_FOXGLOVE names a folder in which `npm install @foxglove/ws-protocol
@foxglove/rosmsg @foxglove/rosmsg2-serialization ws` was run.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from components import loose_script, numbers_script
from viewer import SUBPROTOCOLS, Serve

from uoarm.testing import patience, wait

PACKAGES = (
    "@foxglove/ws-protocol@0.8", "@foxglove/rosmsg@5", "@foxglove/rosmsg2-serialization@3", "ws@8",
)  # fmt: skip
VIEWER = Path(__file__).parent / "clients" / "viewer.mjs"


@pytest.fixture(scope="session")
def packages(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a folder that has them."""
    if os.environ.get("UOARM_FOXGLOVE"):
        return os.environ["UOARM_FOXGLOVE"]
    if shutil.which("npm") is None:
        pytest.skip("needs npm: apt install npm")
    folder = str(tmp_path_factory.mktemp("packages"))
    options = ["--prefix", folder, "--no-audit", "--no-fund", "--ignore-scripts", "--silent"]
    fetched = subprocess.run(["npm", "install", *options, *PACKAGES], check=False)
    if fetched.returncode:
        pytest.skip("npm cannot fetch the protocol's client library")
    return folder


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js 18 or later")
@pytest.mark.parametrize("subprotocol", SUBPROTOCOLS)
def test_the_protocols_own_client_sees_publishes_and_calls(
    serve: Serve, packages: str, subprotocol: str, tmp_path: Path
) -> None:
    server = serve()
    url = f"ws://127.0.0.1:{server.ports[0]}/foxglove"
    seen_file = tmp_path / "seen"
    with seen_file.open("wb") as output:
        viewer = subprocess.Popen(
            ["node", str(VIEWER), url, subprotocol, packages],
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
        )

    def seen() -> list[Any]:
        lines = seen_file.read_text(encoding="utf-8").splitlines(keepends=True)
        return [json.loads(line) for line in lines if line.endswith("\n")]

    try:
        wait(lambda: numbers_script.started and loose_script.started, "no subscription")
        numbers_script.put({"data": -5})
        loose_script.put({"text": "x"})
        for expected in (
            {"subprotocol": subprotocol},
            {"topic": "/numbers", "message": {"data": -5}},
            {"topic": "/loose", "message": {"text": "x"}},
            {"call": 5, "reply": {"data": 3}},
        ):
            wait(lambda: expected in seen(), lambda: f"no {expected}: {seen()}")  # noqa: B023
        assert not [item for item in seen() if "error" in item or "status" in item]
        wait(
            lambda: any("/numbers" in item.get("published", ()) for item in seen()),
            "the graph does not have it",
        )
    finally:
        assert viewer.stdin is not None
        viewer.stdin.close()
        try:
            assert viewer.wait(patience()) == 0
        finally:
            viewer.kill()
            viewer.wait()
