"""The structures of a bridge can be read over XML-RPC, from this machine, and nothing more."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from http.client import HTTPConnection
from pathlib import Path
from xmlrpc.client import Fault, ServerProxy

import pytest

from uoarm._host import XmlRpcServer, xmlrpc_server
from uoarm.errors import ListenError
from uoarm.model import Endpoint, Role
from uoarm.testing import MemoryBridge, ResourceSnapshot, patience

NUMBER = {"type": "integer", "maximum": 2**40}


@pytest.fixture
def face() -> Iterator[XmlRpcServer]:
    before = ResourceSnapshot()
    bridge = MemoryBridge("memory", {})
    bridge.emitter("camera", NUMBER)
    ends = [
        Endpoint("memory", "camera", Role.OUTPUT, ("camera",)),
        Endpoint("memory", "absent", Role.OUTPUT, ("absent",)),
    ]
    made = XmlRpcServer(bridge, ends)
    yield made
    made.close()
    bridge.close()
    before.check()


def _proxy(face: XmlRpcServer) -> ServerProxy:
    return ServerProxy(f"http://127.0.0.1:{face.port}/RPC2")


def test_components_ports_and_structures_are_reported(face: XmlRpcServer) -> None:
    with _proxy(face) as proxy:
        assert proxy.components() == ["absent", "camera"]
        assert proxy.ports("camera") == ["default"]
        report = json.loads(str(proxy.structure("camera", "default")))
    assert report["message"]["schema"] == NUMBER


def test_what_cannot_be_described_is_a_fault(face: XmlRpcServer) -> None:
    with _proxy(face) as proxy:
        with pytest.raises(Fault, match="absent"):
            proxy.structure("absent")
        with pytest.raises(Fault, match="there is no port 'other' of a component 'camera'"):
            proxy.structure("camera", "other")


@pytest.mark.parametrize("method", ["close", "describe", "system.listMethods", "_bridge.close"])
def test_no_other_method_can_be_called(face: XmlRpcServer, method: str) -> None:
    with _proxy(face) as proxy, pytest.raises(Fault, match="is not supported"):
        getattr(proxy, method)()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example:80", "Content-Length": "2"}, 403),
        ({"Content-Length": "100000000"}, 413),
        ({"Content-Length": "-1"}, 413),
        ({"Content-Length": "\xb2"}, 413),
        ({"Content-Length": "9" * 5000}, 413),
        ({"Content-Length": "2", "Origin": "http://127.0.0.1:80"}, 403),
        ({"Content-Length": "2", "Content-Encoding": "gzip"}, 415),
    ],
)
def test_requests_from_elsewhere_and_long_ones_are_refused(
    face: XmlRpcServer, headers: dict[str, str], status: int, capfd: pytest.CaptureFixture[str]
) -> None:
    connection = HTTPConnection("127.0.0.1", face.port, timeout=patience())
    connection.putrequest("POST", "/RPC2", skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    assert connection.getresponse().status == status
    connection.close()
    assert capfd.readouterr().err == ""


def _post(face: XmlRpcServer, body: bytes) -> str:
    connection = HTTPConnection("127.0.0.1", face.port, timeout=patience())
    connection.request("POST", "/RPC2", body)
    answer = connection.getresponse().read().decode()
    connection.close()
    return answer


def _call(value: str, before: str = "") -> bytes:
    call = f"<methodCall><methodName>ports</methodName><params><param>{value}</param></params>"
    return f"<?xml version='1.0'?>{before}{call}</methodCall>".encode()


BOMB = "<!DOCTYPE x [<!ENTITY a 'aaaaaaaaaa'>" + "".join(
    f"<!ENTITY {name} '{f'&{inner};' * 10}'>"
    for inner, name in zip("abcdefgh", "bcdefghi", strict=True)
)
HOSTILE = {
    "entities": _call("<value>&i;</value>", f"{BOMB}]>"),
    "a file": _call("<value>&f;</value>", "<!DOCTYPE x [<!ENTITY f SYSTEM 'file:///etc/passwd'>]>"),
    "a declaration in another encoding": b"<?xml version='1.0' encoding='cp037'?>"
    + "<!DOCTYPE x [<!ENTITY f 'aaaa'>]><x>&f;</x>".encode("cp037"),
    "a huge integer": _call(f"<value><int>{'9' * 60_000}</int></value>"),
    "a huge exponent": _call("<value><bigdecimal>1e999999999</bigdecimal></value>"),
    "deep": _call("<value><array><data>" * 1500 + "</data></array></value>" * 1500),
    "an unknown type": _call("<value><ex:nil/></value>"),
    "no XML": b"\x00\xff" * 100,
    "nothing": b"",
    "half of it": _call("<value>")[:60],
}


@pytest.mark.parametrize("body", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_body_is_answered_with_a_fault_and_no_traceback(
    face: XmlRpcServer, body: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    answer = _post(face, body)
    assert "<fault>" in answer or "<array><data>" in answer  # a component of an odd name has none
    assert "root:" not in answer
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("kind", "cause"),
    [
        ("entities", "declarations are not taken"),
        ("a file", "declarations are not taken"),
        ("a declaration in another encoding", "not a request"),
    ],
)
def test_a_document_type_declaration_is_refused(face: XmlRpcServer, kind: str, cause: str) -> None:
    assert cause in _post(face, HOSTILE[kind])


def test_idle_connections_cost_few_threads_and_end(
    face: XmlRpcServer, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    before = threading.active_count()
    with ExitStack() as stack, monkeypatch.context() as hasty:
        hasty.setattr(xmlrpc_server, "_CONNECTION_SECONDS", 0.05)
        idle = [
            stack.enter_context(socket.create_connection(("127.0.0.1", face.port), patience()))
            for _ in range(2 * xmlrpc_server._CONNECTIONS)
        ]
        for item in idle[::2]:
            with suppress(OSError):
                item.sendall(
                    b"POST /RPC2 HTTP/1.1\r\nHost: 127.0.0.1:1\r\nContent-Length: 9\r\n\r\n<"
                )
        for item in idle:
            with suppress(ConnectionResetError):
                while item.recv(4096):
                    pass
            assert threading.active_count() <= before + xmlrpc_server._CONNECTIONS
    with _proxy(face) as proxy:
        assert proxy.components() == ["absent", "camera"]
    assert capfd.readouterr().err == ""


def test_a_port_that_is_taken_is_named(face: XmlRpcServer) -> None:
    place = f"127.0.0.1:{face.port}"
    with pytest.raises(ListenError, match=f"cannot listen on {place}: Address already in use$"):
        XmlRpcServer(MemoryBridge("other", {}), [], face.port)


def test_the_command_answers_until_it_is_interrupted(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(
        "version: 1\nbridges: {python: {}}\nfunctions:\n  a: {components: [{name: c, "
        'bridge: python, service: {endpoint: ["parts:double"]}}]}\n'
    )
    (tmp_path / "parts.py").write_text("def double(value: int) -> int: return 2 * value\n")
    command = [sys.executable, "-m", "uoarm", "host", "python", "--xmlrpc", "0"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        place = process.stdout.readline().split()[-1]
        with ServerProxy(place) as proxy:
            report = json.loads(str(proxy.structure("c")))
        process.send_signal(signal.SIGINT)
        assert process.wait(patience()) == 0
    assert report["request"]["schema"]["type"] == "integer"
