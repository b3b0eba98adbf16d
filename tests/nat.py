"""A network behind a router that translates addresses: namespaces that a test makes, as root."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from uoarm.testing import patience

OUTSIDE = "198.51.100.1"
"""The address outside; every address is in namespaces of the test, so each run has the same."""

_ROUTER = ("198.51.100.2", "198.51.100.3")
_INSIDE, _GATEWAY = "192.168.7.2", "192.168.7.1"
# What belongs to no connection that the router knows is dropped without a word.
_RULES = """
table ip nat {
  chain leaving {
    type nat hook postrouting priority 100
    oifname "wan" masquerade
  }
}
table ip wall {
  chain passing {
    type filter hook forward priority 0; policy drop
    ct state established accept
    iifname "lan" ct state new accept
  }
}
"""


def _run(*words: str, text: str | None = None) -> None:
    subprocess.run(
        words, input=text, capture_output=True, text=True, timeout=patience(), check=True
    )


class Nat:
    """One machine outside, one inside, and the router between them, a namespace each.

    Nothing outside has a route to the address inside.
    """

    def __init__(self) -> None:
        self._outside, self._router, self._inside = self._namespaces = [
            f"uoarm-nat-{os.getpid()}-{name}" for name in ("outside", "router", "inside")
        ]
        self._address, self._next_address = _ROUTER

    @property
    def outside(self) -> list[str]:
        """What stands before a command that runs outside."""
        return ["ip", "netns", "exec", self._outside]

    @property
    def inside(self) -> list[str]:
        """What stands before a command that runs inside."""
        return ["ip", "netns", "exec", self._inside]

    def make(self) -> None:
        """Make it.

        Raises:
            CalledProcessError: the kernel or a missing right stands in the way.
        """
        self.remove()  # what a killed run with this number left
        for name in self._namespaces:
            _run("ip", "netns", "add", name)
        for end, namespace in (("wan", self._outside), ("lan", self._inside)):
            link = ["ip", "link", "add", end, "netns", self._router, "type", "veth"]
            _run(*link, "peer", "name", "eth0", "netns", namespace)
        for namespace, device, address in (
            (self._outside, "eth0", OUTSIDE),
            (self._router, "wan", self._address),
            (self._router, "lan", _GATEWAY),
            (self._inside, "eth0", _INSIDE),
        ):
            _run("ip", "-n", namespace, "addr", "add", f"{address}/24", "dev", device)
            _run("ip", "-n", namespace, "link", "set", device, "up")
        _run("ip", "-n", self._inside, "route", "add", "default", "via", _GATEWAY)
        within = ["ip", "netns", "exec", self._router]
        # A packet in the midst of a connection makes no new entry, as with strict routers.
        for setting in ("ipv4/ip_forward:1", "netfilter/nf_conntrack_tcp_loose:0"):
            name, _, value = setting.partition(":")
            _run(*within, "tee", f"/proc/sys/net/{name}", text=value)
        _run(*within, "nft", "-f", "-", text=_RULES)

    def renumber(self) -> None:
        """Give the router another address outside: it forgets every connection."""
        device = ["dev", "wan"]
        _run("ip", "-n", self._router, "addr", "del", f"{self._address}/24", *device)
        self._address, self._next_address = self._next_address, self._address
        _run("ip", "-n", self._router, "addr", "add", f"{self._address}/24", *device)

    def remove(self) -> None:
        for name in self._namespaces:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


@contextmanager
def nat() -> Iterator[Nat]:
    """Give such networks, or skip the test and say why there can be none."""
    absent = [name for name in ("ip", "nft") if shutil.which(name) is None]
    if absent:
        pytest.skip(f"not installed: {', '.join(absent)}")
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    made = Nat()
    try:
        try:
            made.make()
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no router can be made: {' '.join(error.cmd)}: {error.stderr.strip()}")
        yield made
    finally:
        made.remove()
