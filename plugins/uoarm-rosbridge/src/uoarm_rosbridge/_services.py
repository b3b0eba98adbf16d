"""Services of one rosbridge client: those it calls and those it provides."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from uoarm.errors import BridgeError, UsageError
from uoarm.model import Message, Role, show_value
from uoarm.server.front_end import Backend, Client, LimitError, Operation, UnknownError
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import Addresses, NamedPort, find_place
from uoarm_rosbridge._rosapi import PREFIX, Rosapi, RosapiCatalogue
from uoarm_rosbridge._types import reader_of
from uoarm_rosbridge._wire import fragment_size

__all__ = ["ClientServices"]

Fields = Mapping[str, Any]
_CANCEL = "/_action/cancel_goal"


class ClientServices:
    """Calls and answers of one client, in the loop's thread.

    Args:
        client: its limits and its rights.
        backend: where functions are called.
        hub: where clients call one another.
        catalogue: answers what rosapi asks of the whole robot.
        addresses: of functions, which clients may call by them.
        send: sends one message to the client, in fragments of a size, 0 for none.
        ask: sends another client's request; raises BusyError where it leaves too much unread.
        cancel_goals: asks for the end of all the client's goals to an action.
    """

    def __init__(
        self,
        client: Client,
        backend: Backend,
        hub: Hub,
        catalogue: RosapiCatalogue,
        addresses: Addresses,
        send: Callable[[Fields, int], None],
        ask: Callable[[Fields], None],
        cancel_goals: Callable[[NamedPort], None],
    ) -> None:
        self._client = client
        self._limits = client.limits
        self._backend = backend
        self._hub = hub
        self._addresses = addresses
        self._send = send
        self._ask = ask
        self._cancel_goals = cancel_goals
        self._rosapi = Rosapi(catalogue, hub, client)
        self._provided: set[str] = set()

    async def call(self, fields: Fields) -> None:
        """Call a service and send its response."""
        arguments = fields.get("args")
        limit, most = fields.get("timeout"), self._limits.call_seconds
        timeout = min(float(limit), most) if isinstance(limit, int | float) and limit > 0 else most
        stated = str(fields.get("type") or "")
        values = await self._answer(str(fields["service"]), stated, arguments, timeout)
        response = {
            "op": "service_response",
            "service": fields["service"],
            "values": values,
            "result": True,
        }
        if fields.get("id") is not None:
            response["id"] = fields["id"]
        self._send(response, fragment_size(fields))

    def advertise(self, fields: Fields) -> None:
        """Provide a service to other clients."""
        place = find_place(fields["service"])
        self._client.require(Operation.SEND, place.right)
        if place.function or place.name.startswith(PREFIX):
            raise UsageError(f"{place.name!r} belongs to the server")
        if len(self._provided) >= self._limits.streams:
            raise LimitError(f"{self._limits.streams} services are provided; withdraw one first")
        self._hub.provide(place.name, fields["type"], self)
        self._provided.add(place.name)

    def unadvertise(self, fields: Fields) -> None:
        """Provide a service no more."""
        name = find_place(fields["service"]).name
        if name not in self._provided:
            raise UsageError(f"this client does not provide {name!r}")
        self._provided.discard(name)
        self._hub.withdraw(name, self)

    def respond(self, fields: Fields) -> None:
        """Pass on the client's answer to a request."""
        values = fields.get("values")

        def conclude(future: Any) -> None:
            if fields["result"] is True:
                future.set_result({} if values is None else values)
            else:
                future.set_exception(BridgeError(f"the service said no: {show_value(values, 500)}"))

        self._hub.answer(str(fields["id"]), self, conclude)

    def refused(self, fields: Fields, why: str) -> None:
        """Have who waits for an answer of this client know why it was refused."""
        self._hub.refused(fields.get("id"), self, why)

    def ask(self, identity: str, service: str, message: Message) -> None:
        """Send another client's request to this one, which provides the service."""
        self._ask({"op": "call_service", "id": identity, "service": service, "args": message})

    def close(self) -> None:
        """Withdraw everything."""
        self._hub.forget(self)

    async def _answer(
        self, service: str, stated: str, arguments: Message, timeout: float
    ) -> Message:
        place = find_place(service)
        if place.name.startswith(PREFIX):
            return await self._rosapi.call(place.name.removeprefix(PREFIX), arguments)
        if place.name.endswith(_CANCEL):
            self._cancel_goals(find_place(place.name.removesuffix(_CANCEL)))
            return {"return_code": 0, "goals_canceling": []}
        self._client.require(Operation.CALL, place.right)
        if not place.function:
            if not self._hub.provides(place.name):
                hint = self._addresses.hint(place.name, Role.SERVICE, self._client)
                if hint:
                    raise UnknownError(hint)
            given = {} if arguments is None else arguments
            return await self._hub.call(place.name, stated, given, timeout)
        read = reader_of(f"service {place.name!r}", stated)
        return await self._backend.call(place.wanted, arguments, read, timeout)
