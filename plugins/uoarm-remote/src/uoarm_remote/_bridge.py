"""The bridge: functions of another manager as components of this one."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Delivery,
    Description,
    Discovered,
    ServiceStructures,
    Sink,
    Source,
    reading_endpoint,
)
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message, MessageStructure, Role, StopOutcome
from uoarm_remote._channels import FunctionSink, FunctionSource, FunctionStreams
from uoarm_remote._discovery import described, discovered
from uoarm_remote._link import ManagerLink
from uoarm_remote._options import FunctionOptions, ManagerOptions, check_address


class RemoteManagerBridge(Bridge):
    """One other manager. An endpoint's address is one of its functions, and a port of it."""

    capabilities = Capabilities(discover=True, call=True, stop=True)

    def __init__(self, name: str, options: ManagerOptions) -> None:
        super().__init__(name, options)
        self._given = options
        self._other = ManagerLink(name, options, lambda: self.manager, self.report)
        self._streams = FunctionStreams(self._other)
        self._called: set[tuple[str, ...]] = set()

    @property
    def process_id(self) -> int | None:
        """Return None: the other manager is anywhere."""
        return None

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows of the link."""
        return {
            "url": self._given.url,
            "manager": self._other.peer,
            "breaks": self._other.breaks,
            "clock_ahead": self._other.ahead,
        }

    def _describe(self, endpoint: Endpoint) -> Description:
        _options(endpoint)
        return described(self._other, endpoint, self._given.timeout)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        options = _options(endpoint)
        source = FunctionSource(
            endpoint, structure, options, self._other, deliver, self.report_channel
        )
        source.open(self._streams, self._given.timeout)
        return source

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        options = _options(endpoint)
        sink = FunctionSink(endpoint, structure, options, self._other, self.report_channel)
        sink.open(self._streams, self._given.timeout)
        return sink

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures
        if endpoint.address not in self._called:  # which costs as much as the rest of it here
            _options(endpoint)
            self._called.add(endpoint.address)
        fields = {"jsonMessage": message, "x-timeout": timeout, **self._other.way()}
        try:
            with ExitStack() as stack:
                reply: Message = self._other.ask_at_once(
                    "Call",
                    lambda: (endpoint.address[0], fields),
                    timeout,
                    lambda cancel: stack.enter_context(self.cancelling(cancel)),
                )
        except MessageError as error:
            # What fitted here: it is another service there by now, and is to be described again.
            self.report(Health.OK, str(error), component=endpoint.component)
            raise
        return reply

    def _keeps_time(self, endpoint: Endpoint) -> bool:
        del endpoint
        return True  # nothing is waited for but the answer, for so long

    def _discover(self) -> tuple[Discovered, ...]:
        if not self._given.discover:
            self._other.require(self._given.timeout)
            return ()
        return discovered(self._other, self.name, self._given.timeout)

    def _stop_all(self, release: bool, timeout: float) -> tuple[StopOutcome, ...]:  # noqa: FBT001
        more: dict[str, Any] = {"jsonMessage": {"release": True}} if release else {}
        try:
            report = self._other.ask("Stop", "", timeout, **more)
        except BridgeError as error:
            if error.reason is FailureReason.NOT_FOUND:
                return ()  # the role has no such right there, so that it is not this one's to stop
            raise
        return () if release else tuple(map(_outcome, report["inputs"]))

    def _close(self) -> None:
        self._other.close()


def _outcome(report: Mapping[str, Any]) -> StopOutcome:
    return StopOutcome(
        str(report["function"]),
        str(report["component"]),
        str(report["port"]),
        stopped=report["stopped"] is True,
        since=report.get("since"),
        cause=str(report.get("cause", "")),
    )


def _options(endpoint: Endpoint) -> FunctionOptions:
    with reading_endpoint(endpoint):
        check_address(endpoint.address)
    if endpoint.is_offered:
        text = f"{endpoint}: a function is offered by `export:` of this configuration, not here"
        raise BridgeError(text, FailureReason.UNSUPPORTED)
    if endpoint.role is Role.SERVICE and len(endpoint.address) > 1:
        raise BridgeError(f"{endpoint}: a service has no ports", FailureReason.BAD_ENDPOINT)
    return FunctionOptions.of_endpoint(endpoint)
