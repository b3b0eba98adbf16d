"""The container's files: what they name is there, they run as no root, and the check is true."""

from __future__ import annotations

import json
import re
import shlex
import ssl
import subprocess
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.processes import run_python

from uoarm.cli._service import options_of_serve

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"


def instructions() -> list[tuple[str, str]]:
    text = (DEPLOY / "Dockerfile").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    joined = re.sub(r"\\\n\s*", " ", "\n".join(lines))
    return [(line.split(" ", 1)[0], line.split(" ", 1)[1]) for line in joined.splitlines() if line]


def of(name: str) -> list[str]:
    return [rest for instruction, rest in instructions() if instruction == name]


def test_everything_that_is_copied_is_there_and_nothing_else_is_sent() -> None:
    copied = [rest.split()[0] for rest in of("COPY") if not rest.startswith("--from=")]
    assert copied == ["dist", "deploy/healthcheck.py"]
    ignored = (DEPLOY / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    assert [line[1:] for line in ignored if line.startswith("!")] == copied
    assert (ROOT / "deploy/healthcheck.py").is_file()


def test_it_runs_as_no_root_and_writes_its_state_only() -> None:
    last = [name for name, _ in instructions()]
    assert of("USER") == ["10001:10001"]
    assert last.index("USER") < last.index("ENTRYPOINT")
    assert not [name for name in last[last.index("USER") :] if name in {"RUN", "COPY", "ADD"}]
    assert of("VOLUME") == ["/var/lib/uoarm"]
    environment = shlex.split(of("ENV")[0])
    assert {"XDG_STATE_HOME=/var/lib/uoarm", "UOARM_HOME=/var/lib/uoarm"} <= set(environment)


def test_packages_are_those_of_this_repository() -> None:
    [packages] = [rest for rest in of("ARG") if rest.startswith("PACKAGES")]
    named = re.findall(r"(uoarm[\w-]*)(?:\[([\w,]+)\])?", packages)
    folders = {"uoarm", *(path.name for path in (ROOT / "plugins").glob("uoarm-*"))}
    assert {name for name, _ in named} <= folders
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for extra in dict(named)["uoarm"].split(","):
        assert re.search(rf"^{extra} = \[", project, re.MULTILINE), extra


def test_the_commands_are_of_uoarm_serve() -> None:
    assert json.loads(of("ENTRYPOINT")[0]) == ["/opt/uoarm/bin/uoarm"]
    for words in (json.loads(of("CMD")[0]), compose()["command"]):
        assert words[0] == "serve"
        given = options_of_serve(words[1:])
        assert given["place"] == "/etc/uoarm/robot.yaml"
        # Off loopback the server starts with an access file only.
        assert (given["host"], given["access"]) == ("0.0.0.0", "/etc/uoarm/access.yaml")
        assert of("EXPOSE") == [given["port"]]


def compose() -> Any:
    document = yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))
    return document["services"]["uoarm"]


def test_compose_gives_it_no_more_than_it_needs() -> None:
    service = compose()
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert {"mem_limit", "pids_limit", "stop_grace_period", "init"} <= set(service)
    assert "privileged" not in service
    assert all(port.startswith("127.0.0.1:") for port in service["ports"])
    assert service["volumes"][0].endswith(":ro")
    assert (DEPLOY / service["build"]["context"] / service["build"]["dockerfile"]).is_file()


class Answer(BaseHTTPRequestHandler):
    status = 200

    def do_GET(self) -> None:
        self.send_response(self.status if self.path == "/healthz" else 404)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


class Ill(Answer):
    status = 503


@pytest.fixture
def serving() -> Iterator[Any]:
    servers: list[ThreadingHTTPServer] = []
    threads: list[threading.Thread] = []

    class Quiet(ThreadingHTTPServer):
        def handle_error(self, *_: object) -> None:
            """A client that spoke plain HTTP where TLS is spoken."""

    def serve(handler: type[Answer], context: ssl.SSLContext | None = None) -> int:
        server = Quiet(("127.0.0.1", 0), handler)
        if context is not None:
            server.socket = context.wrap_socket(server.socket, server_side=True)
        servers.append(server)
        threads.append(threading.Thread(target=server.serve_forever))
        threads[-1].start()
        return int(server.server_address[1])

    yield serve
    for server, thread in zip(servers, threads, strict=True):
        server.shutdown()
        server.server_close()
        thread.join()


def check(port: int | str) -> subprocess.CompletedProcess[str]:
    return run_python(DEPLOY / "healthcheck.py", env={"UOARM_PORT": str(port)})


def test_the_check_of_health_is_true_of_a_server_with_and_without_tls(serving: Any) -> None:
    trustme = pytest.importorskip("trustme")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    trustme.CA().issue_cert("127.0.0.1").configure_cert(context)
    assert check(serving(Answer)).returncode == 0
    assert check(serving(Answer, context)).returncode == 0


def test_the_check_of_health_fails_where_nothing_answers_well(serving: Any) -> None:
    ill = check(serving(Ill))
    assert ill.returncode == 1
    assert "does not answer: HTTP: status 503, TLS: " in ill.stderr
    assert check(1).returncode == 1


@pytest.mark.parametrize("port", ["http", "", "0", "65536"])
def test_the_check_of_health_refuses_what_is_no_port(port: str) -> None:
    refused = check(port)
    assert refused.returncode == 1
    assert refused.stderr == f"UOARM_PORT: expected a port, 1 to 65535, got '{port}'\n"
