"""The protocol's conformance suite against the server, as npm brings it.

UOARM_MCP_CONFORMANCE names a folder in which `npm install` was run for PACKAGES; else npm is asked.
The suite needs a newer Node.js than most systems have, so it comes with one.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from conformance_parts import CONFIGURATION
from tests.processes import run_program  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Server, ServerOptions, serve_in_thread

PACKAGES = ("@modelcontextprotocol/conformance@0.2.0-alpha.12", "node@22")

REVISIONS = ("2025-11-25", "2026-07-28")
NO_CONTENT = "a result is data of the robot, with links to what is large; pictures come on request"
NO_SESSION = "nothing is asked of a client in the midst of a call: an approval is no elicitation"
NO_LOG = "the log stays with the server; what happened is in the status"
NO_PROGRESS = "a call answers at once or with a handle"
OWN_ADDRESS = "the suite asks for an address of its own; streams have others"
NO_PROMPTS = "there are no prompts"
NO_TASKS = "an extension; work that lasts has a handle, and wait, goal_status and cancel"
WHOLE = "a message whose structure combines others is the field `message` of the arguments"

# What does not apply, and why: a scenario, or one check of it.
LEFT_OUT = {
    "logging-set-level": NO_LOG,
    "completion-complete": NO_PROMPTS,
    "tools-call-image": NO_CONTENT,
    "tools-call-audio": NO_CONTENT,
    "tools-call-embedded-resource": NO_CONTENT,
    "tools-call-mixed-content": NO_CONTENT,
    "tools-call-with-logging": NO_LOG,
    "tools-call-with-progress": NO_PROGRESS,
    "tools-call-sampling": NO_SESSION,
    "tools-call-elicitation": NO_SESSION,
    "elicitation-sep1034-defaults": NO_SESSION,
    "elicitation-sep1330-enums": NO_SESSION,
    "resources-read-text": OWN_ADDRESS,
    "resources-read-binary": OWN_ADDRESS,
    "resources-templates-read": OWN_ADDRESS,
    "resources-subscribe": OWN_ADDRESS,
    "resources-unsubscribe": OWN_ADDRESS,
    "prompts-list": NO_PROMPTS,
    "prompts-get-simple": NO_PROMPTS,
    "prompts-get-with-args": NO_PROMPTS,
    "prompts-get-embedded-resource": NO_PROMPTS,
    "prompts-get-with-image": NO_PROMPTS,
    "caching/sep-2549-prompts-list-caching-hints": NO_PROMPTS,
    "server-stateless/sep-2575-server-rejects-undeclared-capability": NO_SESSION,
    "server-stateless/sep-2575-missing-capability-http-400": NO_SESSION,
    "server-stateless/sep-2575-http-server-no-independent-requests-on-stream": NO_SESSION,
    "server-stateless/sep-2575-server-no-log-without-loglevel": NO_LOG,
    "input-required-result-basic-elicitation": NO_SESSION,
    "input-required-result-basic-sampling": NO_SESSION,
    "input-required-result-basic-list-roots": NO_SESSION,
    "input-required-result-request-state": NO_SESSION,
    "input-required-result-multiple-input-requests": NO_SESSION,
    "input-required-result-multi-round": NO_SESSION,
    "input-required-result-non-tool-request": NO_SESSION,
    "input-required-result-result-type": NO_SESSION,
    "input-required-result-tampered-state": NO_SESSION,
    "input-required-result-capability-check": NO_SESSION,
    "tasks-lifecycle": NO_TASKS,
    "tasks-capability-negotiation": NO_TASKS,
    "tasks-wire-fields": NO_TASKS,
    "tasks-request-state-removal": NO_TASKS,
    "tasks-mrtr-input": NO_TASKS,
    "tasks-request-headers": NO_TASKS,
    "tasks-dispatch-and-envelope": NO_TASKS,
    "tasks-required-task-error": NO_TASKS,
    "tasks-mrtr-composition": NO_TASKS,
    "json-schema-2020-12": WHOLE,
}


@pytest.fixture(scope="session")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the packages."""
    if os.environ.get("UOARM_MCP_CONFORMANCE"):
        return Path(os.environ["UOARM_MCP_CONFORMANCE"])
    if shutil.which("npm") is None:
        pytest.skip("needs npm: apt install npm")
    folder = tmp_path_factory.mktemp("packages")
    options = ["--prefix", str(folder), "--no-audit", "--no-fund", "--silent"]
    fetched = subprocess.run(["npm", "install", *options, *PACKAGES], check=False)
    if fetched.returncode:
        pytest.skip("npm cannot fetch the conformance suite")
    return folder


@pytest.fixture
def server() -> Iterator[Server]:
    origin = str(Path(__file__).parent / "robot.yaml")
    options = ServerOptions(port=0, front_end_ports={"mcp": 0})
    with (
        RobotManager(loads(CONFIGURATION, origin=origin)) as robot,
        serve_in_thread(robot, options) as served,
    ):
        yield served


def outcome(suite: Path, server: Server, revision: str, folder: Path) -> tuple[set[str], set[str]]:
    """Run what a revision requires; return the checks that passed and those that failed."""
    modules = suite / "node_modules"
    program = modules / "@modelcontextprotocol" / "conformance" / "dist" / "index.js"
    url = f"http://127.0.0.1:{server.ports[1]}/mcp"
    words = ["server", "--url", url, "--requirements", revision, "--output-dir", str(folder)]
    ran = run_program(modules / ".bin" / "node", program, *words)
    found: dict[str, set[str]] = {"SUCCESS": set(), "FAILURE": set()}
    for results in folder.glob("server-*"):
        scenario = re.sub(r"-\d{4}-\d\d-\d\dT.*", "", results.name.removeprefix("server-"))
        for check in json.loads((results / "checks.json").read_text("utf-8")):
            if check["status"] in found:
                found[check["status"]].add(f"{scenario}/{check['id']}")
    assert len(found["SUCCESS"]) > 20, ran.stdout + ran.stderr
    return found["SUCCESS"], found["FAILURE"]


def test_all_scenarios_that_apply_pass(suite: Path, server: Server, tmp_path: Path) -> None:
    failed: set[str] = set()
    for revision in REVISIONS:
        passed, others = outcome(suite, server, revision, tmp_path / revision)
        failed |= others
        assert {f"tools-list/{name}" for name in ("tools-list", "wire-schema-valid")} <= passed
    explained = {
        name: next((entry for entry in (name, name.partition("/")[0]) if entry in LEFT_OUT), None)
        for name in failed
    }
    assert [name for name, entry in explained.items() if entry is None] == []
    assert LEFT_OUT.keys() - explained.values() == set(), "these pass now: take them out"
