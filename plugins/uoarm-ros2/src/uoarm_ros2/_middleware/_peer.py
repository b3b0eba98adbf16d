"""Ends of topics as the graph shows them."""

from __future__ import annotations

from typing import Any

from attrs import frozen

from uoarm_ros2._middleware._profile import read_profile
from uoarm_ros2._qos import Policies

__all__ = ["Peer", "read_peer"]

_PREFIX_BYTES = 12


@frozen
class Peer:
    """One publisher or subscription on the graph, with what it offers or asks.

    `identity` is its own for as long as it lives, also while the graph does not know its node yet;
    `definition` is the hash of its type's definition, empty where it is not told (REP-2011).
    """

    node: str
    type: str
    policies: Policies
    identity: bytes = b""
    definition: str = ""

    @property
    def participant(self) -> bytes:
        """What its identity has in common with every other end of its DDS participant."""
        return self.identity[:_PREFIX_BYTES]


def read_peer(info: Any) -> Peer:
    """Return the end that an entry of the graph tells of."""
    node = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
    policies, identity = read_profile(info.qos_profile), bytes(info.endpoint_gid)
    return Peer(node, info.topic_type, policies, identity, _definition(info))


def _definition(info: Any) -> str:
    """Return a type's hash as ROS 2 writes it; Humble and nodes older than it tell none."""
    report = getattr(info, "topic_type_hash", None)
    if report is None or report.version < 1:
        return ""
    return f"RIHS{report.version:02}_{bytes(report.value).hex()}"
