"""`uoarm fleet --browse`: what is announced is listed, bounded and escaped, and never used."""

from __future__ import annotations

import json
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from robots import fleet
from uoarm_remote import _command
from uoarm_remote._command import (
    MOST,
    SERVICE,
    AnnouncedManager,
    Browser,
    _place,
    _shown,
    announced_text,
)
from zeroconf import (  # type: ignore[attr-defined]  # two that it imports, and does not list
    DNSOutgoing,
    DNSPointer,
    ServiceInfo,
    Zeroconf,
)

from uoarm.bridge import install_command
from uoarm.cli import _announce
from uoarm.errors import BridgeError, PluginError
from uoarm.testing import wait

LOOPBACK = ["127.0.0.1"]
IDENTITY = "0123456789abcdef0123456789abcdef"
GOOD: dict[str, Any] = {"id": IDENTITY, "protocol": "v1", "tls": "1"}


class Network:
    """What announces on loopback: well, badly, or in bad faith."""

    def __init__(self) -> None:
        self.zeroconf = Zeroconf(interfaces=LOOPBACK)

    def announce(
        self,
        name: str,
        properties: dict[str, Any] | bytes,
        addresses: tuple[str, ...] = ("192.0.2.7",),
        port: int = 9080,
    ) -> ServiceInfo:
        info = ServiceInfo(
            _command.SERVICE,
            f"{name}.{_command.SERVICE}",
            port=port,
            parsed_addresses=list(addresses),
            properties=properties,
            server=f"{name}-{_command.SERVICE[1:12]}.local.",  # of this test alone, as the type
        )
        self.zeroconf.register_service(
            info, cooperating_responders=True
        )  # without the wait for others
        return info

    def claim(self, *names: str) -> None:
        """Say that there are managers of these names, and nothing else of them."""
        for name in names:
            message = DNSOutgoing(0x8400)  # an answer that speaks for itself
            message.add_answer_at_time(
                DNSPointer(_command.SERVICE, 12, 1, 4500, f"{name}.{_command.SERVICE}"), 0
            )
            self.zeroconf.send(message)


@pytest.fixture(autouse=True)
def _service(monkeypatch: pytest.MonkeyPatch) -> None:
    """A type of its own: what tests beside this one announce on loopback is received here, too."""
    monkeypatch.setattr(_command, "SERVICE", f"_u{secrets.token_hex(5)}._tcp.local.")


@pytest.fixture
def network() -> Iterator[Network]:
    made = Network()
    yield made
    made.zeroconf.close()


@contextmanager
def browsing() -> Iterator[Browser]:
    with Browser(LOOPBACK) as browser:
        yield browser


def read(browser: Browser, *names: str) -> dict[str, AnnouncedManager]:
    """Wait until these are there and read, well or not."""

    there: dict[str, AnnouncedManager] = {}

    def are_known() -> bool:
        there.clear()
        there.update((manager.name, manager) for manager in browser.found())
        return all(
            name in there and "does not say an address" not in there[name].cause for name in names
        )

    wait(are_known)
    return there


def test_looked_for_is_what_a_server_is_announced_as() -> None:
    """The plugin imports public modules only, so that the type stands in two places."""
    assert SERVICE == _announce.SERVICE  # and not the one of a single test


def test_a_manager_is_listed_until_it_is_withdrawn(network: Network) -> None:
    with browsing() as browser:
        assert browser.found() == []
        info = network.announce("robot3", GOOD, ("192.0.2.7", "2001:db8::7"))
        manager = read(browser, "robot3")["robot3"]
        assert manager == AnnouncedManager(
            "robot3", manager.urls, IDENTITY, tls=True, protocol="v1"
        )
        assert set(manager.urls) == {"wss://192.0.2.7:9080/", "wss://[2001:db8::7]:9080/"}
        network.zeroconf.unregister_service(info)
        wait(lambda: browser.found() == [])
        network.announce("plain", {**GOOD, "tls": "0"})
        assert read(browser, "plain")["plain"].urls == ("ws://192.0.2.7:9080/",)


@pytest.mark.parametrize(
    ("properties", "cause"),
    [
        ({}, "id: expected 32 hexadecimal digits, got ''"),
        ({**GOOD, "id": "0" * 33}, f"id: expected 32 hexadecimal digits, got '{'0' * 33}'"),
        ({**GOOD, "id": "\x1b[2J" + "0" * 200}, "id: expected 32 hexadecimal digits, got '\\u{1b}"),
        ({**GOOD, "id": b"\xff" * 32}, "id: expected 32 hexadecimal digits"),
        ({**GOOD, "id": None}, "id: expected"),
        ({**GOOD, "id": f"{IDENTITY}\n"}, "id: expected"),
        ({**GOOD, "tls": "yes"}, "tls: expected 0 or 1, got 'yes'"),
        ({**GOOD, "protocol": "v1\nbridges:"}, "protocol: expected a version such as v1"),
        (b"\xff\x00\x05id=a", "id: expected"),
    ],
)
def test_what_cannot_be_read_is_a_line(
    network: Network, properties: dict[str, Any] | bytes, cause: str
) -> None:
    with browsing() as browser:
        network.announce("bad", properties)
        network.announce("good", GOOD)
        found = read(browser, "bad", "good")
    assert found["bad"].urls == ()
    assert found["bad"].cause.startswith(cause)
    assert found["bad"].cause.isprintable()
    assert len(found["bad"].cause) < 200
    text = announced_text([found["bad"], found["good"]])
    assert text.splitlines()[0] == f"-  bad  cannot be read: {found['bad'].cause}"
    assert text.splitlines()[1].startswith("manager1  good  ")
    assert "manager2" not in text


@pytest.mark.parametrize("address", ["127.0.0.1", "0.0.0.0", "224.0.0.1", "::1", "fe80::1"])
def test_an_address_of_no_other_machine_is_refused(network: Network, address: str) -> None:
    with browsing() as browser:
        network.announce("bad", GOOD, (address,))
        found = read(browser, "bad")
    assert found["bad"].cause == "it says no address that can be reached from another machine"


def test_addresses_are_bounded_and_those_of_ipv4_in_ipv6_refused(network: Network) -> None:
    assert _place("::ffff:127.0.0.1") == ""
    with browsing() as browser:
        network.announce("many", GOOD, tuple(f"192.0.2.{number}" for number in range(1, 40)))
        assert len(read(browser, "many")["many"].urls) == 8


def test_names_are_escaped_and_bounded(network: Network) -> None:
    evil = "a\x1b[2J\r\n\u202eb"
    with browsing() as browser:
        network.claim(evil, "x" * 60 + "\x07", "")
        wait(lambda: len(browser.found()) >= 2)
        found = browser.found()
    names = {manager.name for manager in found}
    assert "a\\u{1b}[2J\\u{d}\\u{a}\\u{202e}b" in names
    assert all(name.isprintable() and len(name) <= 64 for name in names)
    assert all(manager.cause for manager in found)
    assert len(announced_text(found).splitlines()) == len(found)
    assert _shown("\n" * 10**6) == "\\u{a}" * 12 + "\\..."


def test_a_flood_is_cut_off(network: Network) -> None:
    with browsing() as browser:
        network.claim(*(f"flood{number}" for number in range(MOST + 20)))
        wait(lambda: browser.is_full)
        assert len(browser.found()) == MOST
        assert len(browser._looking) <= MOST


def test_what_is_pasted_is_made_here_but_for_addresses() -> None:
    managers = [
        AnnouncedManager("one: {x", ("wss://192.0.2.7:1/", "wss://192.0.2.8:1/"), IDENTITY, True),
        AnnouncedManager("two", ("ws://[2001:db8::7]:2/",), IDENTITY, False, "v1"),
    ]
    first, second, _, *pasted = announced_text(managers).splitlines()
    assert first.startswith("manager1  one: {x  wss://192.0.2.7:1/ wss://192.0.2.8:1/  identity ")
    assert "  no TLS  protocol v1" in second
    assert pasted == [
        "bridges:",
        (
            '  manager1: {plugin: remote, options: {url: "wss://192.0.2.7:1/", '
            "token_file: manager1.token}}"
        ),
        (
            '  manager2: {plugin: remote, options: {url: "ws://[2001:db8::7]:2/", '
            "token_file: manager2.token}}"
        ),
    ]


def test_the_command_lists_what_was_announced(
    network: Network, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    network.announce("robot3", GOOD)
    with browsing() as browser:
        read(browser, "robot3")
        with monkeypatch.context() as patched:
            patched.setattr(_command, "Browser", lambda: _Entered(browser))
            patched.setattr(_command, "time", SimpleNamespace(sleep=lambda _: None))
            assert fleet("--browse", "--json") == 0
            (shown,) = json.loads(capsys.readouterr().out)
            assert fleet("--browse") == 0
    assert shown["urls"] == ["wss://192.0.2.7:9080/"]
    assert (shown["identity"], shown["tls"], shown["cause"]) == (IDENTITY, True, "")
    assert "token_file: manager1.token" in capsys.readouterr().out


class _Entered:
    """A browser that listens already, and goes on."""

    def __init__(self, browser: Browser) -> None:
        self._browser = browser

    def __enter__(self) -> Browser:
        return self._browser

    def __exit__(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("given", ["0", "-1", "61", "nan", "x"])
def test_seconds_are_bounded(given: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert fleet("--browse", "--seconds", given) == 2
    assert "--seconds" in capsys.readouterr().err


def test_it_reads_no_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    assert fleet("robot.yaml", "--browse") == 2
    assert "leave robot.yaml out" in capsys.readouterr().err


def test_without_the_extra_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zeroconf", None)
    with pytest.raises(PluginError) as raised:
        Browser()
    # Where a checkout runs, the name alone would install what an index has of it.
    assert f"needs: {install_command('uoarm', 'zeroconf')} (" in str(raised.value)
    assert raised.value.error_code == "UOA-302"


def test_a_network_that_cannot_be_listened_to_is_an_error_of_ours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def without_network(**_: object) -> Zeroconf:
        raise OSError(19, "No such device")

    monkeypatch.setattr("zeroconf.Zeroconf", without_network)
    with pytest.raises(BridgeError, match=r"cannot be listened to for managers: .*No such device"):
        Browser()
