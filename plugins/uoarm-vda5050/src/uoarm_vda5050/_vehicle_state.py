"""The vehicle's side of the protocol: which orders it takes, and what it does next.

No clock, no socket, no thread: orders and instant actions come in, and what the drive did; the task
and the members of a state come out. The rules are those of the standard's chapter on orders and
updates. One thing at a time is done: the actions of a node one after the other, then the next edge.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

from attrs import define, field, frozen

from uoarm_vda5050._releases import VdaRelease

Body = dict[str, Any]

_MOST_NODES = 10_000
_MOST_ACTION_STATES = 10_000
_MOST_INSTANT_STATES = 100
_ENDED = frozenset({"FINISHED", "FAILED"})
_WHERE = 0.5
"""Metres within which a vehicle is at a node that states no deviation."""


@frozen
class Drive:
    """Drive to a node, over the edge before it.

    Attributes:
        sequence_id: of the node in the order.
        x: metres on the map; None where the order states no position, as y, theta and map_id.
        y: metres.
        theta: radians; None where any will do.
        map_id: of the map.
        deviation: metres within which it is reached.
        max_speed: metres a second; None: as fast as it may.
    """

    node_id: str
    sequence_id: int
    x: float | None
    y: float | None
    theta: float | None
    map_id: str | None
    deviation: float
    max_speed: float | None
    order_id: str


@frozen
class Act:
    """Perform an action where the vehicle stands.

    Attributes:
        action_type: what is to be done.
        parameters: values by key.
        node_id: of the node traversed last.
    """

    action_id: str
    action_type: str
    parameters: Mapping[str, Any] = field(eq=False)
    node_id: str
    order_id: str


Task = Drive | Act


@define
class VehicleState:
    """What a vehicle knows of its order, and reports.

    Attributes:
        known: types of actions that it can perform within orders.
        position: x, y, theta, map; None while it does not know where it is.
        driving: whether it moves.
        paused: whether an instant action has it wait.
        mode: operating mode.
        errors: what it reports, by type.
    """

    release: VdaRelease
    known: frozenset[str]
    position: tuple[float, float, float, str] | None = None
    driving: bool = False
    paused: bool = False
    mode: str = "AUTOMATIC"
    errors: dict[str, Body] = field(factory=dict)
    order_id: str = ""
    update_id: int = 0
    last_node: str = ""
    last_sequence: int = 0
    _nodes: deque[Body] = field(factory=deque)
    _edges: deque[Body] = field(factory=deque)
    _last: Body | None = None  # the last released node: where an update begins
    _waiting: deque[Body] = field(factory=deque)  # actions to perform before driving on
    _states: dict[str, Body] = field(factory=dict)
    _instants: dict[str, Body] = field(factory=dict)
    _content: Body | None = None
    _cancelling: list[Body] = field(factory=list)  # states of what cancels the order
    _is_cancelled: bool = False
    _refused: set[str] = field(factory=set)

    @property
    def task(self) -> Task | None:
        """What is to be done now; None: stand still."""
        if self.paused or self._cancelling or self.mode not in {"AUTOMATIC", "SEMIAUTOMATIC"}:
            return None
        if self._waiting:
            action = self._waiting[0]
            kind, given = action["actionType"], _parameters(action)
            return Act(action["actionId"], kind, given, self.last_node, self.order_id)
        if not self._nodes or not self._nodes[0]["released"]:
            return None
        return self._drive(self._nodes[0], self._edges[0] if self._edges else {})

    @property
    def is_idle(self) -> bool:
        """Whether no order is under way: nothing left to drive, no action that has not ended."""
        left = [state for state in self._states.values() if state["actionStatus"] not in _ENDED]
        return not (self._nodes or self._edges or left)

    def order(self, body: Body) -> bool:
        """Take an order or an update; return whether it was taken.

        What is refused stands in the errors until an order is taken.
        """
        errors = self.release.errors
        wrong = _malformed(body)
        if wrong:
            return self._refuse(errors.malformed, wrong, body)
        order_id, update_id = body["orderId"], body["orderUpdateId"]
        if self.mode not in {"AUTOMATIC", "SEMIAUTOMATIC", "INTERVENED"}:
            return self._refuse(errors.mode, f"operating mode {self.mode}", body)
        if order_id == self.order_id:
            if update_id == self.update_id:
                if errors.differs and body != self._content:
                    return self._refuse(errors.differs, "another content", body)
                return False
            wrong, kind = self._no_update(body)
        else:
            wrong, kind = self._no_order(body)
        if not wrong:
            kind = errors.action
            unknown = sorted({action["actionType"] for action in _actions(body)} - self.known)
            wrong = f"no such actions: {', '.join(unknown)}" if unknown else ""
        if wrong:
            return self._refuse(kind, wrong, body)
        self._take(body, is_new=order_id != self.order_id)
        return True

    def instant(self, action: Body) -> str:
        """Take an instant action; return its type where the caller is to do something about it."""
        kind = action.get("actionType") or action.get("actionName", "")
        action_id = action["actionId"]
        if action_id in self._instants:
            return ""
        status = "FINISHED"
        if kind == "cancelOrder":
            status = self._cancel(action)
        elif kind == "startPause":
            self.paused = True
        elif kind == "stopPause":
            self.paused = False
        elif kind not in {"stateRequest", "factsheetRequest"}:
            status = "FAILED"
            text = f"no instant action {kind!r}"
            self._note(self.release.errors.instant, text, {"actionId": action_id})
        state = {"actionId": action_id, "actionType": kind, "actionStatus": status}
        self._instants[action_id] = state
        if status == "RUNNING":
            self._cancelling.append(state)  # the order stands until the vehicle does
        while len(self._instants) > _MOST_INSTANT_STATES:
            self._instants.pop(next(iter(self._instants)))
        return str(kind)

    def reached(self, task: Task) -> bool:
        """A node was traversed; return whether it was the task."""
        if not isinstance(task, Drive) or task != self.task:
            return False
        if self._edges:
            self._edges.popleft()
        self._traverse(self._nodes.popleft())
        return True

    def started(self, task: Task) -> bool:
        """An action is being performed; return whether it was the task."""
        if not isinstance(task, Act) or task != self.task:
            return False
        changed: bool = self._states[task.action_id]["actionStatus"] != "RUNNING"
        self._states[task.action_id]["actionStatus"] = "RUNNING"
        return changed

    def finished(self, task: Task, result: str) -> bool:
        """An action was performed; return whether it was the task."""
        if not isinstance(task, Act) or task != self.task:
            return False
        self._waiting.popleft()
        self._set_status(task.action_id, "FINISHED", result)
        self._advance()
        return True

    def failed(self, task: Task, why: str) -> bool:
        """A task cannot be done, and the order ends with it; return whether it was the task."""
        if task != self.task:
            return False
        if isinstance(task, Act):
            self._waiting.popleft()
            self._set_status(task.action_id, "FAILED", why)
        self._clear()
        return True

    def stands(self) -> bool:
        """The vehicle stands: a cancellation is finished; return whether one was under way."""
        was = bool(self._cancelling)
        if was:
            self._clear()
        for item in self._cancelling:
            item["actionStatus"] = "FINISHED"
        self._cancelling.clear()
        return was

    def set_mode(self, mode: str) -> None:
        """Change the operating mode; in those in which no master sends orders there is none."""
        self.mode = mode
        if mode not in {"AUTOMATIC", "SEMIAUTOMATIC", "INTERVENED"}:
            self._clear()

    def refuse_unreadable(self, why: str) -> None:
        """Report a message that cannot be read."""
        self._refuse(self.release.errors.malformed, why, {})

    def body(self) -> Body:
        """Return the members of a state that say what becomes of orders."""
        own = [dict(state) for state in self._states.values()]
        instants = [dict(instant) for instant in self._instants.values()]
        made: Body = {
            "orderId": self.order_id,
            "orderUpdateId": self.update_id,
            "lastNodeId": self.last_node,
            "lastNodeSequenceId": self.last_sequence,
            "nodeStates": [_left(node, "nodeId") for node in self._nodes],
            "edgeStates": [_left(edge, "edgeId") for edge in self._edges],
            "driving": self.driving,
            "paused": self.paused,
            "newBaseRequest": bool(self._nodes) and not self._nodes[0]["released"],
            "operatingMode": self.mode,
            "errors": [dict(error) for error in self.errors.values()],
        }
        if self.release.instant_states == "actionStates":
            made["actionStates"] = [*own, *instants]
        else:
            made["actionStates"], made[self.release.instant_states] = own, instants
        return made

    def _no_order(self, body: Body) -> tuple[str, str]:
        errors = self.release.errors
        if not self.is_idle:
            return f"order {self.order_id!r} is under way", errors.busy
        if not self._is_at(body["nodes"][0]):
            return f"the first node {body['nodes'][0]['nodeId']!r} is not here", errors.start
        return "", ""

    def _no_update(self, body: Body) -> tuple[str, str]:
        errors = self.release.errors
        if body["orderUpdateId"] < self.update_id:
            return f"update {self.update_id} was taken already", errors.outdated
        if self._is_cancelled:
            return "the order was cancelled", errors.cancelled
        first, last = body["nodes"][0], self._last
        if last is None or (first["nodeId"], first["sequenceId"]) != (
            last["nodeId"],
            last["sequenceId"],
        ):
            where = "nothing" if last is None else f"{last['nodeId']!r} ({last['sequenceId']})"
            return f"it begins at {first['nodeId']!r}, the order ends at {where}", errors.gap
        return "", ""

    def _take(self, body: Body, *, is_new: bool) -> None:
        for name in self._refused:
            self.errors.pop(name, None)
        self._refused.clear()
        self.order_id, self.update_id = body["orderId"], body["orderUpdateId"]
        self._content, self._is_cancelled = body, False
        nodes = [dict(node) for node in body["nodes"]]
        edges = [dict(edge) for edge in body["edges"]]
        if is_new:
            self._states.clear()
            self._nodes, self._edges = deque(nodes), deque(edges)
        else:
            for part in (*self._nodes, *self._edges):
                for action in part["actions"] if not part["released"] else ():
                    self._states.pop(action["actionId"], None)  # the horizon of before
            base = [node for node in self._nodes if node["released"]]
            ways = [edge for edge in self._edges if edge["released"]]
            self._nodes, self._edges = deque([*base, *nodes[1:]]), deque([*ways, *edges])
        for part in (*self._nodes, *self._edges):
            for action in part["actions"]:
                self._states.setdefault(action["actionId"], _waiting(action))
        self._last = [node for node in nodes if node["released"]][-1]
        if is_new:
            self._traverse(self._nodes.popleft())
        else:
            self._advance()

    def _traverse(self, node: Body) -> None:
        self.last_node, self.last_sequence = node["nodeId"], node["sequenceId"]
        self._waiting.extend(node["actions"])
        self._advance()

    def _advance(self) -> None:
        """Have the actions of the next edge performed, once those of the node have been."""
        if not self._waiting and self._edges and self._edges[0]["released"]:
            todo = [action for action in self._edges[0]["actions"] if self._is_waiting(action)]
            self._waiting.extend(todo)

    def _is_waiting(self, action: Body) -> bool:
        return bool(self._states[action["actionId"]]["actionStatus"] == "WAITING")

    def _cancel(self, action: Body) -> str:
        """Cancel the order; return the status of the action that asks for it."""
        other = _parameters(action).get("orderId", self.order_id) != self.order_id
        if self.is_idle or other:
            text = "there is no order to cancel"
            self._note(self.release.errors.nothing, text, {"actionId": action["actionId"]})
            return "FAILED"
        self._is_cancelled = True
        if self.driving:
            return "RUNNING"
        self._clear()
        return "FINISHED"

    def _clear(self) -> None:
        self._nodes.clear()
        self._edges.clear()
        self._waiting.clear()
        self._last = None
        for state in self._states.values():
            if state["actionStatus"] not in _ENDED:
                state["actionStatus"] = "FAILED"

    def _set_status(self, action_id: str, status: str, said: str) -> None:
        state = self._states[action_id]
        state["actionStatus"] = status
        if said:
            name = "resultDescription" if self.release.major == "2" else "actionResult"
            state[name] = said

    def _refuse(self, kind: str, why: str, body: object) -> bool:
        said = body if isinstance(body, dict) else {}
        references = {key: str(said[key]) for key in ("orderId", "orderUpdateId") if key in said}
        self._note(kind, why, references)
        return False

    def _note(self, kind: str, why: str, references: Mapping[str, str]) -> None:
        named = [
            {"referenceKey": key, "referenceValue": reference}
            for key, reference in references.items()
        ]
        self.errors[kind] = {
            "errorType": kind,
            "errorLevel": "WARNING",
            "errorDescription": why[:500],
            "errorReferences": named,
        }
        self._refused.add(kind)

    def _is_at(self, node: Body) -> bool:
        place = node.get("nodePosition")
        if place is None:
            return self.last_node in {"", node["nodeId"]}
        if self.position is None:  # it does not know where it is
            return False
        x, y, _, map_id = self.position
        if place["mapId"] != map_id:
            return False
        return math.hypot(place["x"] - x, place["y"] - y) <= _deviation(place)

    def _drive(self, node: Body, edge: Body) -> Drive:
        place = node.get("nodePosition") or {}
        return Drive(
            node["nodeId"],
            node["sequenceId"],
            place.get("x"),
            place.get("y"),
            place.get("theta"),
            place.get("mapId"),
            _deviation(place),
            edge.get(self.release.speed),
            self.order_id,
        )


def _deviation(place: Mapping[str, Any]) -> float:
    allowed = place.get("allowedDeviationXY", _WHERE)
    if isinstance(allowed, Mapping):  # an ellipse: its smaller half axis is safe
        allowed = min(allowed["a"], allowed["b"])
    return float(allowed) or _WHERE


def _left(part: Body, name: str) -> Body:
    return {key: part[key] for key in (name, "sequenceId", "released")}


def _parameters(action: Body) -> Body:
    given = action.get("actionParameters") or ()
    return {parameter["key"]: parameter["value"] for parameter in given}


def _waiting(action: Body) -> Body:
    return {
        "actionId": action["actionId"],
        "actionType": action["actionType"],
        "actionStatus": "WAITING",
    }


def _actions(body: Body) -> list[Body]:
    return [action for part in (*body["nodes"], *body["edges"]) for action in part["actions"]]


def _malformed(body: Body) -> str:
    """Say what is wrong with an order that has the structure of one, "" where nothing is."""
    nodes, edges = body["nodes"], body["edges"]
    if len(nodes) > _MOST_NODES or len(_actions(body)) > _MOST_ACTION_STATES:
        return "too many nodes or actions"
    if len(edges) != len(nodes) - 1:
        return f"{len(nodes)} nodes and {len(edges)} edges"
    first = nodes[0]["sequenceId"]
    parts: list[Body] = [{}] * (len(nodes) + len(edges))
    parts[::2], parts[1::2] = nodes, edges
    if [part["sequenceId"] for part in parts] != [*range(first, first + len(parts))]:
        return "sequenceId does not count nodes and edges in turn"
    released = [part["released"] for part in parts]
    if not released[0] or released != sorted(released, reverse=True):
        return "something is released behind what is not"
    ids = [action["actionId"] for action in _actions(body)]
    return "" if len(set(ids)) == len(ids) else "two actions have the same actionId"
