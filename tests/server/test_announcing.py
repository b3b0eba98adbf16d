"""`uoarm serve --announce`: what the network learns of a served manager, and until when."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.cables import laid_cable
from tests.processes import run_python
from zeroconf import ServiceBrowser, ServiceInfo, ServiceStateChange, Zeroconf

from uoarm.cli import _announce
from uoarm.cli._announce import SERVICE, Announcement
from uoarm.cli._main import main
from uoarm.errors import ConfigurationError, PluginError
from uoarm.server import ServerOptions, hash_token
from uoarm.testing import patience, wait

LOOPBACK = ["127.0.0.1"]
IDENTITY = "0123456789abcdef0123456789abcdef"
CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  secret_camera: {components: [{name: eye, bridge: python, output: {endpoint: ["builtins:int"]}}]}
"""


class Listener:
    """What is announced on some interfaces now."""

    def __init__(self, interfaces: list[str]) -> None:
        self._network = Zeroconf(interfaces=interfaces)
        self._names: set[str] = set()
        self._browser = ServiceBrowser(self._network, SERVICE, handlers=[self._changed])

    def _changed(self, *, name: str, state_change: ServiceStateChange, **_: object) -> None:
        if state_change is ServiceStateChange.Removed:
            self._names.discard(name)
        else:
            self._names.add(name)

    def named(self, part: str) -> list[str]:
        return [name for name in list(self._names) if part in name]

    def info(self, name: str) -> ServiceInfo:
        found = ServiceInfo(SERVICE, name)
        wait(lambda: found.request(self._network, 1000))
        return found

    def close(self) -> None:
        self._browser.cancel()
        self._network.close()


@contextmanager
def listening(interfaces: list[str]) -> Iterator[Listener]:
    listener = Listener(interfaces)
    try:
        yield listener
    finally:
        listener.close()


@pytest.mark.parametrize("secured", [False, True])
def test_a_manager_is_announced_until_the_end_with_these_facts_only(*, secured: bool) -> None:
    identity = os.urandom(16).hex()
    settings = ServerOptions(own_certificate=secured)
    with listening(LOOPBACK) as listener:
        with Announcement(identity, settings, LOOPBACK) as announcement:
            announcement.start(9081)
            wait(lambda: listener.named(identity[:8]))
            (name,) = listener.named(identity[:8])
            info = listener.info(name)
            assert info.port == 9081
            assert info.parsed_addresses() == LOOPBACK
            assert info.server == f"uoarm-{identity}.local."
            assert info.properties == {
                b"id": identity.encode(),
                b"protocol": b"v1",
                b"tls": b"1" if secured else b"0",
            }
        wait(lambda: not listener.named(identity[:8]))


def test_a_server_that_only_this_machine_reaches_is_not_announced() -> None:
    for host in ("127.0.0.1", "::1", "localhost"):
        with pytest.raises(ConfigurationError, match=f"{host} can be reached from this machine"):
            Announcement(IDENTITY, ServerOptions(host=host))


def test_the_command_refuses_it_in_one_line_before_anything_listens(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(CONFIGURATION, encoding="utf-8")
    ran = CliRunner().invoke(main, ["serve", str(file), "--port", "0", "--announce"])
    assert ran.exit_code == 3
    assert "leave --announce out" in ran.stderr
    assert "serving" not in ran.output


def test_without_the_extra_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zeroconf", None)
    with pytest.raises(PluginError, match=r"zeroconf") as raised:
        Announcement(IDENTITY, ServerOptions(host="0.0.0.0"))
    assert raised.value.error_code == "UOA-302"


def test_a_long_name_of_a_machine_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "r" * 64 + ".example.org")
    identity = os.urandom(16).hex()
    announced = Announcement(identity, ServerOptions(), LOOPBACK)
    with listening(LOOPBACK) as listener, announced as announcement:
        announcement.start(9081)
        wait(lambda: listener.named(f"{'r' * 40}-{identity[:8]}"))


@pytest.mark.parametrize(
    ("addresses", "cause"),
    [
        ([], "this machine has no address on a network"),
        (["192.0.2.1"], "No such device"),
    ],
)
def test_a_network_that_fails_is_a_warning(
    monkeypatch: pytest.MonkeyPatch, addresses: list[str], cause: str
) -> None:
    def without_network(**_: object) -> Zeroconf:
        raise OSError(19, "No such device")

    lines: list[str] = []
    monkeypatch.setattr(_announce, "print_warning", lines.append)
    monkeypatch.setattr("zeroconf.Zeroconf", without_network)
    monkeypatch.setattr(_announce, "_addresses", lambda _: addresses)
    with Announcement(IDENTITY, ServerOptions(host="0.0.0.0")) as announcement:
        announcement.start(9081)
        wait(lambda: lines)
    assert lines == [f"not announced: {cause}"]


def test_addresses_are_those_that_others_reach() -> None:
    assert _announce._addresses(ServerOptions(host="192.0.2.1")) == ["192.0.2.1"]
    for host in ("0.0.0.0", "::"):
        found = _announce._addresses(ServerOptions(host=host))
        assert not [text for text in found if text.startswith(("127.", "::1", "fe80:"))]


def test_nothing_of_it_is_imported_without_the_option() -> None:
    code = "import sys, uoarm.cli._serve; print('zeroconf' in sys.modules, 'ifaddr' in sys.modules)"
    ran = run_python("-c", code, check=True)
    assert ran.stdout == "False False\n"


def test_a_served_robot_is_announced_until_it_is_terminated(tmp_path: Path) -> None:
    file, access = tmp_path / "robot.yaml", tmp_path / "access.yaml"
    file.write_text(CONFIGURATION, encoding="utf-8")
    access.write_text(
        "version: 1\nroles: {fleet: {see: all}}\n"
        f"tokens: [{{name: desk, role: fleet, sha256: {hash_token('a' * 43)}}}]\n"
    )
    with laid_cable() as cable, listening([cable.here]) as listener:
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "uoarm",
                "serve",
                str(file),
                "--host",
                cable.here,
                "--port",
                "0",
                "--access",
                str(access),
                "--announce",
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "XDG_STATE_HOME": str(tmp_path / "state")},
        )
        try:
            assert process.stderr is not None
            said = next(line for line in process.stderr if line.startswith("announced"))
            name = f"{said.split()[-1]}.{SERVICE}"
            wait(lambda: listener.named(name))
            info = listener.info(name)
            assert info.parsed_addresses() == [cable.here]
            process.send_signal(signal.SIGTERM)
            wait(lambda: not listener.named(name))
            shown, _ = process.communicate(timeout=patience())
        finally:
            process.kill()
            process.communicate()
        assert process.returncode == 0
        assert re.search(rf"ws://{re.escape(cable.here)}:{info.port}/", shown)
