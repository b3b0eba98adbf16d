"""Mistakes of meaning about hosts: settings that do not go together, machines that cannot join."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

from uoarm._yaml import Path, clip
from uoarm.config._parts import bridge_names, listening
from uoarm.model import place_problem

__all__ = ["host_mistakes"]

Mistake: TypeAlias = "tuple[Path, str, str]"
"""Path of the key at fault, sentence, hint."""

_WITH_MACHINE = {"machine", "silence", "start"}


def host_mistakes(value: object) -> Iterator[Mistake]:
    """Yield every mistake in a document's `hosts` and in the `host` of each bridge."""
    for name, bridge in bridge_names(value).items():
        host = bridge.get("host") if isinstance(bridge, dict) else None
        if isinstance(host, dict):
            yield from _mistakes_of(("bridges", name, "host"), host, listening(value))
    yield from _mistakes_of_place(listening(value))


def _mistakes_of(
    path: Path, host: dict[str, object], hosts: dict[str, object]
) -> Iterator[Mistake]:
    if "machine" not in host:
        if "environment" in host and "python" in host:
            yield (*path, "python"), "give either environment or python, not both", ""
        return
    for key in host:
        if key not in _WITH_MACHINE:
            sentence = f"{key} is settled on the machine itself, where the host is started"
            yield (*path, key), sentence, "machine goes with silence and start only"
    if not hosts:
        hint = "add hosts: {listen: tls/ADDRESS:PORT, certificates: FOLDER} to the file"
        yield (*path, "machine"), "nothing says where this machine joins", hint


def _mistakes_of_place(hosts: dict[str, object]) -> Iterator[Mistake]:
    place = hosts.get("listen")
    if not isinstance(place, str):
        return
    problem = place_problem(place)
    if problem:
        yield ("hosts", "listen"), f"{problem}; got {clip(place)}", ""
    elif place.startswith("tls/") and "certificates" not in hosts:
        hint = "name the folder that `uoarm certificates` made"
        yield ("hosts", "listen"), "TLS needs certificates", hint
