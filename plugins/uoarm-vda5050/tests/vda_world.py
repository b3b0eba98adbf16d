"""The world of the conformance kit: vehicles on a real Mosquitto, by paho alone."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from typing import Any

from brokers import Broker, Peer
from uoarm_vda5050.vehicle import Vehicle

from fleet import MAKER, Driver, endpoint
from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing.conformance import Pair, Retained, Served, Victim, World

NAMES = itertools.count()
HEADER = {"timestamp": "2026-01-01T00:00:00.00Z", "version": "2.1.0", "manufacturer": MAKER}
ORDER: Any = {"orderId": "o", "orderUpdateId": 0, "edges": []}


class VdaWorld(World):
    """Vehicles of its own on a broker that lasts longer than a test."""

    def __init__(self, broker: Broker) -> None:
        self.broker = broker
        self.at = f"world{next(NAMES)}"
        self.peers: list[Peer] = []
        self.drivers: list[Driver] = []
        self._vehicle("pair")

    def spec(self) -> BridgeSpec:
        options = {"url": self.broker.url, "interface": self.at, "retained_wait": 0}
        options |= {"accept_timeout": self.patience, "state_timeout": self.patience}
        return BridgeSpec("fleet", "vda5050", options)

    def pair(self, kind: str) -> Pair:
        address = (MAKER, "pair", kind)
        sink = Endpoint("fleet", "pair", Role.INPUT, address)
        return Pair(sink, Endpoint("fleet", "pair", Role.OUTPUT, address))

    def missing(self) -> Endpoint:
        return endpoint("nowhere", "state")

    def takes(self, kind: str, message: Message) -> bool:
        del kind
        return not (isinstance(message, dict) and message.keys() & {*HEADER, "headerId"})

    def samples(self, kind: str) -> Sequence[Message]:
        if kind != "order":
            more = {
                "actionId": "a",
                "actionType": "Kia ora \u2192 \U0001f916",
                "blockingType": "HARD",
            }
            return [
                {"actions": []},
                {"actions": [{**more, "actionId": str(n)} for n in range(500)]},
            ]
        nodes = [_node(number) for number in range(500)]
        return [
            {**ORDER, "nodes": [_node(0, nodeDescription="Kia ora \u2192 \U0001f916\r\n\t")]},
            {**ORDER, "nodes": nodes},
            {**ORDER, "nodes": [_node(0, more={"deeper": [1, -0.0, 5e-324, None]})]},
        ]

    def victims(self) -> Sequence[Victim]:
        return [Victim(endpoint(name, "state"), self._vehicle(name).die) for name in ("a", "b")]

    def broken(self) -> bool:
        self.broker.kill()
        return True

    def mended(self) -> None:
        self.broker.start()
        self._vehicle("pair")  # what stood on the broker is gone with it

    def unreadable(self, kind: str) -> Callable[[], object]:
        peer = self.peer()
        return lambda: peer.publish(f"{self.at}/v2/{MAKER}/pair/{kind}", b'{"orderId": [')

    def retained(self) -> Retained:
        peer, message = self.peer(), {"connectionState": "ONLINE"}

        def emit() -> Message:
            self._say(peer, "pair", "connection", message, retain=True)
            return message

        return Retained(endpoint("pair", "connection"), emit)

    def served(self) -> Served:
        holds = {"driver": (), "failing": (), "silent": ("b",)}
        for serial, held in holds.items():
            vehicle = Vehicle(self.broker.url, MAKER, serial, interface=self.at)
            vehicle.set(mode="MANUAL" if serial == "failing" else "AUTOMATIC")
            vehicle.open()
            self.drivers.append(Driver(vehicle, *held))
        return Served(
            endpoint("driver", "transport"),
            _goal("order"),
            _result("order"),
            endpoint("failing", "transport"),
            endpoint("silent", "transport"),
        )

    def peer(self, will: tuple[str, str] | None = None) -> Peer:
        self.peers.append(Peer(self.broker, will))
        return self.peers[-1]

    def close(self) -> None:
        for driver in self.drivers:
            driver.close()
            driver.vehicle.close()
        for peer in self.peers:
            peer.close()

    def _vehicle(self, serial: str) -> Peer:
        gone = {**HEADER, "headerId": 0, "serialNumber": serial}
        gone["connectionState"] = "CONNECTIONBROKEN"
        peer = self.peer((f"{self.at}/v2/{MAKER}/{serial}/connection", json.dumps(gone)))
        self._say(peer, serial, "connection", {"connectionState": "ONLINE"}, retain=True)
        return peer

    def _say(self, peer: Peer, serial: str, topic: str, body: Any, *, retain: bool) -> None:
        whole = {**HEADER, "headerId": 1, "serialNumber": serial, **body}
        place = f"{self.at}/v2/{MAKER}/{serial}/{topic}"
        peer.publish(place, json.dumps(whole), retain=retain)


def _node(number: int, **more: Any) -> dict[str, Any]:
    made = {"nodeId": f"n{number}", "sequenceId": 2 * number, "released": True, "actions": []}
    return {**made, **more}


def _goal(order: str) -> dict[str, Any]:
    return {"orderId": order, "nodes": [{"nodeId": "a"}, {"nodeId": "b"}]}


def _result(order: str) -> dict[str, Any]:
    ended: dict[str, Any] = {"lastNodeId": "b", "reason": "", "actions": [], "errors": []}
    return {"orderId": order, **ended}
