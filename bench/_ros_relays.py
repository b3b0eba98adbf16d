"""What the relays of ROS 1 and ROS 2 have in common: ours, each in a process of its own."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

RELAYS = ("uoarm bridge, source to sink", "uoarm native link", "uoarm manager, adapted route")
_ROBOT = """
version: 1
bridges: {{ros: {{plugin: {plugin}, options: {{}}}}}}
functions:
  octets: {{components: [{{name: here, bridge: ros, output: {output}}}]}}
  relayed: {{components: [{{name: there, bridge: ros, input: {input}}}]}}
"""


def relay(
    name: str,
    plugin: str,
    addresses: tuple[tuple[str, str], tuple[str, str]],
    options: tuple[Mapping[str, Any], Mapping[str, Any]],
    edge: Mapping[str, Any],
) -> None:
    """Be one of our relays of octets until standard input ends; says when it is ready.

    Args:
        name: of `RELAYS`.
        plugin: of the bridge.
        addresses: name and type of the topic that is subscribed to, and of the other one.
        options: of either endpoint.
        edge: what else the manager's input says.
    """
    if "manager" in name:
        _by_manager(plugin, addresses, options, edge)
    else:
        _by_bridge(plugin, addresses, options, is_linked="link" in name)


def _by_manager(plugin: str, addresses: Any, options: Any, edge: Mapping[str, Any]) -> None:
    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.config import loads  # noqa: PLC0415

    here, there = (
        {"endpoint": list(address), "options": given}
        for address, given in zip(addresses, options, strict=True)
    )
    text = _ROBOT.format(
        plugin=plugin,
        output=json.dumps(here),
        input=json.dumps({"from": "octets", **there, **edge}),
    )
    with RobotManager(loads(text)) as robot, robot.request("relayed"):
        _until_input_ends()


def _by_bridge(plugin: str, addresses: Any, options: Any, *, is_linked: bool) -> None:
    from uoarm.bridge import Registry  # noqa: PLC0415
    from uoarm.model import BridgeSpec, Endpoint, Role  # noqa: PLC0415

    bridge = Registry().create(BridgeSpec("ros", plugin, {}))
    source = Endpoint("ros", "here", Role.OUTPUT, addresses[0], options=options[0])
    sink = Endpoint("ros", "there", Role.INPUT, addresses[1], options=options[1])
    structure = bridge.describe(source).message
    assert structure is not None
    if is_linked:
        bridge.link(source, sink)
    else:
        bridge.open_source(source, structure, bridge.open_sink(sink, structure).send)
    _until_input_ends()
    bridge.close()


def _until_input_ends() -> None:
    print("ready", flush=True)
    sys.stdin.read()
