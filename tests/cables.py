"""Cables that are pulled and put back: network namespaces that a test makes itself, as root."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from uoarm.testing import patience

_NETWORKS = 2**14  # of four addresses each, in 10.214.0.0/16
_TRIES = 100


def _ip(*words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["ip", *words], capture_output=True, text=True, timeout=patience(), check=check
    )


class Cable:
    """A cable between this machine and a network namespace; both are this test's own.

    Runs beside this one, and what a killed one left, have numbers of their own: of two interfaces
    with the same addresses one gets the other's packets, so the kernel is asked for a name first
    that is free.
    """

    def __init__(self) -> None:
        self._number = os.getpid() % _NETWORKS
        self._is_laid = False

    def _set_names(self) -> None:
        high, low = divmod(self._number, 64)
        network = f"10.214.{high}"
        self.here, self._address = f"{network}.{4 * low + 1}", f"{network}.{4 * low + 2}"
        self.namespace = f"uoarm-cable-{self._number}"
        self._near, self._far = f"uoarm{self._number}a", f"uoarm{self._number}b"

    def lay(self) -> str:
        """Make it; return what is in the way, "" when it stands."""
        if shutil.which("ip") is None:
            return "the command ip is not installed"
        for _ in range(_TRIES):
            self._set_names()
            made = _ip(
                "link", "add", self._near, "type", "veth", "peer", "name", self._far, check=False
            )
            if made.returncode == 0:
                return self._lead_out()
            if "File exists" not in made.stderr:
                break
            self._number = (self._number + 1) % _NETWORKS
        return f"no pair of interfaces can be made: {made.stderr.strip()}"

    def _lead_out(self) -> str:
        """Lead one end into a namespace of its own."""
        self._is_laid = True
        _ip("netns", "del", self.namespace, check=False)  # the number is this one's now
        made = _ip("netns", "add", self.namespace, check=False)
        if made.returncode != 0:
            return f"no network namespace can be made: {made.stderr.strip()}"
        _ip("link", "set", self._far, "netns", self.namespace)
        _ip("addr", "add", f"{self.here}/30", "dev", self._near)
        _ip("link", "set", self._near, "up")
        _ip("-n", self.namespace, "addr", "add", f"{self._address}/30", "dev", self._far)
        self.mend()
        return ""

    def cut(self) -> None:
        """Have no packet pass, without a word."""
        _ip("-n", self.namespace, "link", "set", self._far, "down")

    def mend(self) -> None:
        _ip("-n", self.namespace, "link", "set", self._far, "up")

    def lose(self, percent: int) -> None:
        """Have so many of a hundred packets from the far end be lost, where there is `nft`."""
        within = ["ip", "netns", "exec", self.namespace]
        for words in (
            ["add", "table", "inet", "loss"],
            ["add", "chain", "inet", "loss", "out", "{ type filter hook output priority 0; }"],
            ["add", "rule", "inet", "loss", "out", f"numgen random mod 100 < {percent} drop"],
        ):
            if shutil.which("nft") is not None:
                subprocess.run([*within, "nft", *words], capture_output=True, check=False)

    def remove(self) -> None:
        if self._is_laid:
            _ip("netns", "del", self.namespace, check=False)
            _ip("link", "del", self._near, check=False)


@contextmanager
def laid_cable() -> Iterator[Cable]:
    """Give a cable, or skip the test and say why there can be none."""
    made = Cable()
    try:
        problem = made.lay()
        if problem:
            pytest.skip(problem)
        yield made
    finally:
        made.remove()
