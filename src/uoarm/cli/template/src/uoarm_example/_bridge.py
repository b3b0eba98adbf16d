"""The bridge: raw steps only; the base class keeps time limits, errors and the list of channels."""

from __future__ import annotations

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    NativeLink,
    ServiceStructures,
    Sink,
    Source,
    reading_endpoint,
)
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Message, MessageStructure
from uoarm_example._channels import (
    ExampleLink,
    ExampleService,
    ExampleSink,
    ExampleSource,
    decode,
    encode,
)
from uoarm_example._connection import ExampleConnection
from uoarm_example._discovery import described, discovered, is_retained
from uoarm_example._options import BusOptions, ExampleOptions, mistake


class ExampleBridge(Bridge):
    """An endpoint's address is one topic or service. Components publish and subscribe on topics."""

    capabilities = Capabilities(discover=True, call=True, serve=True, link=True)

    def __init__(self, name: str, options: BusOptions) -> None:
        super().__init__(name, options)
        self._connection = ExampleConnection(options.host, options.port, options.timeout)

    def _describe(self, endpoint: Endpoint) -> Description:
        _options(endpoint)
        return described(self._connection, endpoint)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        del structure
        return ExampleSource(
            endpoint,
            _options(endpoint),
            self._connection,
            deliver,
            self.report_channel,
            latched=is_retained(self._connection, endpoint),
        )

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        options = _options(endpoint)
        described(self._connection, endpoint)  # refuses what is not there
        return ExampleSink(endpoint, options, self._connection, self.report_channel)

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures
        _options(endpoint)
        service, payload = endpoint.address[0], encode(message)
        reply = self._connection.ask("call", timeout, service=service, payload=payload)
        try:
            return decode(reply)
        except ValueError as error:
            raise BridgeError(f"the reply of {endpoint} cannot be read: {error}") from error

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        schemas = {"request": structures.request.schema, "reply": structures.reply.schema}
        return ExampleService(
            endpoint, _options(endpoint), self._connection, handler, self.report_channel, schemas
        )

    def _link(self, source: Endpoint, sink: Endpoint) -> NativeLink | None:
        options = _options(source)
        return ExampleLink(source, sink, options, self._connection, self.report_channel)

    def _discover(self) -> tuple[Discovered, ...]:
        return discovered(self._connection, self.name)

    def _close(self) -> None:
        self._connection.close()


def _options(endpoint: Endpoint) -> ExampleOptions:
    with reading_endpoint(endpoint):
        if wrong := mistake(endpoint.address, endpoint.options):
            raise ValueError(wrong)
        return ExampleOptions.of(endpoint.options)
