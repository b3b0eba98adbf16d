"""Transport orders to orders of a release, and its states to what all releases have in common."""

from __future__ import annotations

import os
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from attrs import field, frozen

from uoarm.errors import MessageError
from uoarm_vda5050._releases import VdaRelease

Body = dict[str, Any]

_ENDED = frozenset({"FINISHED", "FAILED"})
_INSTANT = frozenset(
    {"cancelOrder", "stateRequest", "factsheetRequest", "startPause", "stopPause", "logReport"}
    | {"downloadMap", "deleteMap"}
)


def new_id() -> str:
    """Return an identifier that no other makes."""
    return os.urandom(8).hex()


@frozen
class Order:
    """An order as it is sent, with what has to be known to follow it.

    Attributes:
        update_id: of this message of it.
        body: of the message, without header.
        steps: node id and sequence id of every node of this message, with whether it is released.
        actions: identifiers of all actions of the order so far.
        goal: the transport order that it was made of.
    """

    order_id: str
    update_id: int
    body: Body
    steps: tuple[tuple[str, int, bool], ...]
    actions: tuple[str, ...]
    goal: Mapping[str, Any] = field(eq=False)

    @classmethod
    def of(cls, goal: Mapping[str, Any], order_id: str, release: VdaRelease, most: int) -> Order:
        """Make the first message of an order.

        Raises:
            MessageError: it can be none; the text says where.
        """
        return _make(goal, order_id, release, most, update_id=0, first=0, before=())

    def extended(self, goal: Mapping[str, Any], release: VdaRelease, most: int) -> Order:
        """Make an update, which begins with the last released node of this message.

        Raises:
            MessageError: it begins elsewhere, or can be no order.
        """
        node_id, sequence, _ = self.decision_point
        nodes = goal.get("nodes") or [{}]
        if nodes[0].get("nodeId") != node_id:
            raise MessageError(
                f"an update of order {self.order_id!r} begins with its last released node "
                f"{node_id!r}, got {nodes[0].get('nodeId')!r}"
            )
        update = self.update_id + 1
        return _make(
            goal,
            self.order_id,
            release,
            most,
            update_id=update,
            first=sequence,
            before=self.actions,
            stitched=self._node(sequence),
        )

    @property
    def decision_point(self) -> tuple[str, int, bool]:
        """The last released node."""
        return [step for step in self.steps if step[2]][-1]

    def _node(self, sequence: int) -> Body:
        nodes: list[Body] = self.body["nodes"]
        return next(node for node in nodes if node["sequenceId"] == sequence)


def _make(
    goal: Mapping[str, Any],
    order_id: str,
    release: VdaRelease,
    most: int,
    *,
    update_id: int,
    first: int,
    before: tuple[str, ...],
    stitched: Body | None = None,
) -> Order:
    given = list(goal.get("nodes", ()))
    if not given:
        raise MessageError("an order has at least one node")
    if len(given) > most:
        raise MessageError(f"an order of {len(given):,} nodes; {most:,} are allowed (max_nodes)")
    ways = list(goal.get("edges", ())) or [{} for _ in given[1:]]
    if len(ways) != len(given) - 1:
        text = f"{len(given)} nodes have {len(given) - 1} edges between them, got {len(ways)}"
        raise MessageError(text)
    released = [bool(node.get("released", True)) for node in given]
    if not released[0] or any(later and not flag for flag, later in pairwise(released)):
        raise MessageError("the first node is released, and none after one that is not")
    nodes = [
        _node(node, first + 2 * n, release, order_id, yes)
        for n, (node, yes) in enumerate(zip(given, released, strict=True))
    ]
    if stitched is not None:  # nothing of a node that is sent again may differ
        nodes[0] = stitched
    edges = []
    for n, edge in enumerate(ways):
        sequence = first + 2 * n + 1
        made: Body = {
            "edgeId": edge.get("edgeId") or f"{nodes[n]['nodeId']}-{nodes[n + 1]['nodeId']}",
            "sequenceId": sequence,
            "released": released[n + 1],
            "actions": _actions(edge, f"{order_id}-{sequence}"),
        }
        if release.major == "2":
            made["startNodeId"], made["endNodeId"] = nodes[n]["nodeId"], nodes[n + 1]["nodeId"]
        if "maxSpeed" in edge:
            made[release.speed] = edge["maxSpeed"]
        edges.append(made)
    actions = [action["actionId"] for part in (*nodes, *edges) for action in part["actions"]]
    more = [action for action in actions if action not in before]
    if len(set(actions)) < len(actions):
        raise MessageError("two actions of the order have the same actionId")
    body: Body = {"orderId": order_id, "orderUpdateId": update_id, "nodes": nodes, "edges": edges}
    steps = tuple((item["nodeId"], item["sequenceId"], item["released"]) for item in nodes)
    return Order(order_id, update_id, body, steps, (*before, *more), goal)


def _node(node: Body, sequence: int, release: VdaRelease, order_id: str, released: bool) -> Body:  # noqa: FBT001
    if not node.get("nodeId"):
        raise MessageError("a node has a nodeId")
    made: Body = {
        "nodeId": node["nodeId"],
        "sequenceId": sequence,
        "released": released,
        "actions": _actions(node, f"{order_id}-{sequence}"),
    }
    if "nodePosition" in node:
        position = dict(node["nodePosition"])
        deviation = position.get("allowedDeviationXY")
        if release.is_elliptic and isinstance(deviation, int | float):
            position["allowedDeviationXY"] = {"a": deviation, "b": deviation, "theta": 0.0}
        made["nodePosition"] = position
    return made


def _actions(part: Body, prefix: str) -> list[Body]:
    return [
        {
            **action,
            "actionId": action.get("actionId") or f"{prefix}-{n}",
            "blockingType": action.get("blockingType", "HARD"),
            "actionParameters": action.get("actionParameters", []),
        }
        for n, action in enumerate(part.get("actions", ()))
    ]


def cancel_order(release: VdaRelease, action_id: str, order_id: str) -> Body:
    """Return the instant action that cancels an order."""
    more = [{"key": "orderId", "value": order_id}] if release.major != "2" else []
    return _instant(release, "cancelOrder", action_id, more)


def state_request(release: VdaRelease, action_id: str) -> Body:
    """Return the instant action that asks for a state."""
    return _instant(release, "stateRequest", action_id, [])


def _instant(release: VdaRelease, kind: str, action_id: str, parameters: list[Body]) -> Body:
    made: Body = {
        "actionType": kind,
        "actionId": action_id,
        "blockingType": release.instant_blocking,
        "actionParameters": parameters,
    }
    if not release.also_named:
        return {"actions": [made]}
    whole, name = release.also_named
    return {"actions": [{**made, name: kind}], whole: [made]}


@frozen
class OrderReport:
    """A state as it came, in names that all releases share.

    Attributes:
        actions: states of the actions of the order, by identifier.
        instants: states of instant actions, by identifier.
        is_active: whether nodes or edges of the order are left.
        is_busy: whether they are, or an action of it has not ended.
    """

    order_id: str
    update_id: int
    last_node: str
    last_sequence: int
    nodes_left: int
    driving: bool
    paused: bool
    actions: Mapping[str, Body]
    instants: Mapping[str, str]
    errors: tuple[Body, ...]
    loads: tuple[Body, ...]
    position: Body | None
    battery: float
    is_active: bool
    is_busy: bool

    @classmethod
    def of(cls, body: Mapping[str, Any], release: VdaRelease) -> OrderReport:
        """Read the body of a state that has the structure of one."""
        own = {state["actionId"]: state for state in body["actionStates"]}
        instants = {item["actionId"]: item["actionStatus"] for item in body[release.instant_states]}
        second, charge = release.battery
        where = body.get(release.position)
        is_left = bool(body["nodeStates"] or body["edgeStates"])
        return cls(
            order_id=body["orderId"],
            update_id=body["orderUpdateId"],
            last_node=body["lastNodeId"],
            last_sequence=body["lastNodeSequenceId"],
            nodes_left=len(body["nodeStates"]),
            driving=body["driving"],
            paused=body.get("paused", False),
            actions=own,
            instants=instants,
            errors=tuple(body["errors"]),
            loads=tuple(body.get("loads", ())),
            position=None if where is None else _position(where, release),
            battery=body[second][charge],
            is_active=is_left,
            # Without an order they are instant actions, all of them.
            is_busy=is_left or bool(body["orderId"] and any(map(_is_left, own.values()))),
        )

    def status_of(self, action_id: str) -> str:
        """Return the status of an action of the order, empty where the vehicle says nothing."""
        found = self.actions.get(action_id)
        return "" if found is None else str(found["actionStatus"])

    def is_under_way(self, action_id: str) -> bool:
        """Say whether the vehicle knows of an action that has not ended."""
        return self.status_of(action_id) not in {"", *_ENDED}

    def is_busy_with(self, order: Order | None) -> bool:
        """Say whether its order is under way; of a known one it is known which actions it has."""
        if order is None or order.order_id != self.order_id:
            return self.is_busy
        return self.is_active or any(map(self.is_under_way, order.actions))

    def feedback(self, order: Order) -> Body:
        """Return the feedback of a transport order."""
        made: Body = {
            "orderId": self.order_id,
            "orderUpdateId": self.update_id,
            "lastNodeId": self.last_node,
            "lastNodeSequenceId": self.last_sequence,
            "driving": self.driving,
            "paused": self.paused,
            "remaining": self.nodes_left,
            "loads": [dict(load) for load in self.loads],
            "actions": self.actions_of(order),
            "errors": [dict(error) for error in self.errors],
            "batteryCharge": self.battery,
        }
        if self.position is not None:
            made["position"] = dict(self.position)
        return made

    def actions_of(self, order: Order) -> list[Body]:
        """Return the states of the actions of an order, in its order."""
        return [dict(self.actions[action]) for action in order.actions if action in self.actions]


def words_of(error: Mapping[str, Any]) -> str:
    """Return the type of an error that a vehicle reports, and what it says of it."""
    return f"{error['errorType']}: {error.get('errorDescription', '')}".rstrip(": ")


def _is_left(action: Mapping[str, Any]) -> bool:
    # Up to 2.1 states of instant actions stand among those of the order's.
    return action["actionStatus"] not in _ENDED and action.get("actionType") not in _INSTANT


def _position(where: Mapping[str, Any], release: VdaRelease) -> Body:
    return {
        "x": where["x"],
        "y": where["y"],
        "theta": where["theta"],
        "mapId": where["mapId"],
        "localized": where[release.localized],
    }
