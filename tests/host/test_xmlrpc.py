"""The structures of a bridge can be read over XML-RPC, from this machine, and nothing more."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from xmlrpc.client import Fault, ServerProxy

import pytest

from uoarm.errors import BridgeError
from uoarm.host import XmlRpcFace
from uoarm.model import Endpoint, Role
from uoarm.testing import Census, MemoryBridge

NUMBER = {"type": "integer", "maximum": 2**40}


@pytest.fixture
def face() -> Iterator[XmlRpcFace]:
    before = Census()
    bridge = MemoryBridge("memory", {})
    bridge.emitter("camera", NUMBER)
    ends = [
        Endpoint("memory", "camera", Role.OUTPUT, ("camera",)),
        Endpoint("memory", "absent", Role.OUTPUT, ("absent",)),
    ]
    made = XmlRpcFace(bridge, ends)
    yield made
    made.close()
    bridge.close()
    before.check()


def _proxy(face: XmlRpcFace) -> ServerProxy:
    return ServerProxy(f"http://127.0.0.1:{face.port}/RPC2")


def test_components_ports_and_structures_are_told(face: XmlRpcFace) -> None:
    with _proxy(face) as proxy:
        assert proxy.components() == ["absent", "camera"]
        assert proxy.ports("camera") == ["default"]
        told = json.loads(str(proxy.structure("camera", "default")))
    assert told["message"]["schema"] == NUMBER


def test_what_cannot_be_described_is_a_fault(face: XmlRpcFace) -> None:
    with _proxy(face) as proxy:
        with pytest.raises(Fault, match="absent"):
            proxy.structure("absent")
        with pytest.raises(Fault, match="there is no port 'other' of a component 'camera'"):
            proxy.structure("camera", "other")


@pytest.mark.parametrize("method", ["close", "describe", "system.listMethods", "_bridge.close"])
def test_no_other_method_can_be_called(face: XmlRpcFace, method: str) -> None:
    with _proxy(face) as proxy, pytest.raises(Fault, match="is not supported"):
        getattr(proxy, method)()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example:80", "Content-Length": "2"}, 403),
        ({"Content-Length": "100000000"}, 413),
        ({"Content-Length": "-1"}, 413),
    ],
)
def test_requests_from_elsewhere_and_long_ones_are_refused(
    face: XmlRpcFace, headers: dict[str, str], status: int
) -> None:
    connection = HTTPConnection("127.0.0.1", face.port, timeout=5)
    connection.putrequest("POST", "/RPC2", skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    assert connection.getresponse().status == status
    connection.close()


def test_a_port_that_is_taken_is_named(face: XmlRpcFace) -> None:
    with pytest.raises(BridgeError, match=f"port {face.port}"):
        XmlRpcFace(MemoryBridge("other", {}), [], face.port)


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
            told = json.loads(str(proxy.structure("c")))
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
    assert told["request"]["schema"]["type"] == "integer"
