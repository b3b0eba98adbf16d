"""The structure database of a bridge over XML-RPC, for tools that speak nothing else."""

from __future__ import annotations

import math
import re
import socket
import sys
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from http import HTTPStatus
from socketserver import ThreadingMixIn
from typing import Any
from xml.parsers.expat import ExpatError, ParserCreate
from xmlrpc.client import Fault, dumps
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

from uoarm._raised import Log, text_of
from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason, ListenError
from uoarm.model import Endpoint, to_json, write_json

_LOOPBACK = "127.0.0.1"
_LARGEST = 64 * 1024
_DESCRIBE_SECONDS = 10.0
_REQUEST_SECONDS = 10.0
_CONNECTION_SECONDS = 30.0
_CONNECTIONS = 32
_PAUSE_SECONDS = 0.1
_DIGITS = re.compile("[0-9]{1,9}")
_log = Log("uoarm.host")


class XmlRpcServer:
    """Answers what a bridge knows of its endpoints; read-only, on the loopback interface only.

    Methods: `components()` names those of the configuration; `ports(component)` their ports;
    `structure(component, port)` returns a port's structures as JSON text, since XML-RPC has
    neither null nor integers above 32 bits; `discover()` lists what is visible now.

    Args:
        bridge: asked anew for every request.
        endpoints: of the components in the configuration.
        port: to listen on; 0: any free one.

    Raises:
        ListenError: the port cannot be had.
    """

    def __init__(self, bridge: Bridge, endpoints: Iterable[Endpoint], port: int = 0) -> None:
        try:
            self._server = _Server((_LOOPBACK, port))
        except OSError as error:
            raise ListenError(f"{_LOOPBACK}:{port}", port, error) from error
        self._server.register_instance(_Database(bridge, endpoints))
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.1,), name="uoarm-xmlrpc", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        port: int = self._server.server_address[1]
        return port

    def close(self) -> None:
        """Answer no more."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class _Database:
    """Exactly the methods that can be called."""

    def __init__(self, bridge: Bridge, endpoints: Iterable[Endpoint]) -> None:
        self._bridge = bridge
        self._endpoints = {(endpoint.component, endpoint.port): endpoint for endpoint in endpoints}

    def components(self) -> list[str]:
        """Return the components of the configuration that this bridge reaches."""
        return sorted({component for component, _ in self._endpoints})

    def ports(self, component: str) -> list[str]:
        return sorted(port for name, port in self._endpoints if name == component)

    def structure(self, component: str, port: str = "default") -> str:
        """Return the structures of a port as JSON text."""
        endpoint = self._endpoints.get((component, port))
        if endpoint is None:
            text = f"there is no port {port!r} of a component {component!r}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return write_json(to_json(self._bridge.describe(endpoint, timeout=_DESCRIBE_SECONDS)))

    def discover(self) -> str:
        """Return the components that are visible now as JSON text."""
        return write_json(to_json(list(self._bridge.discover(timeout=_DESCRIBE_SECONDS))))


class _Handler(SimpleXMLRPCRequestHandler):
    """Refuses what is too long or packed, and what a web page was led to send here."""

    timeout = _REQUEST_SECONDS

    def do_POST(self) -> None:  # noqa: N802 - the standard library's name
        host = self.headers.get("Host", "").rpartition(":")[0]
        length = self.headers.get("Content-Length", "")
        if host not in {_LOOPBACK, "localhost"}:
            self.send_error(HTTPStatus.FORBIDDEN, "only from this machine, by its own name")
        elif "Origin" in self.headers:
            self.send_error(HTTPStatus.FORBIDDEN, "not from a web page")
        elif "Content-Encoding" in self.headers:  # 64 KB may unpack to twenty megabytes
            self.send_error(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "plain XML only")
        elif not _DIGITS.fullmatch(length) or int(length) > _LARGEST:
            self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"{_LARGEST} octets at most")
        else:
            super().do_POST()

    def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002 - as it is there
        """Log what was refused; the standard library writes it to stderr, as often as it comes."""
        _log.debug("XML-RPC: %s", format % arguments)


class _Server(ThreadingMixIn, SimpleXMLRPCServer):
    """One thread a request, so that one that waits for a framework holds up no other.

    There are some threads only, and each connection has its time: one that sends an octet now and
    then would else keep its thread.
    """

    daemon_threads = True
    request_queue_size = (
        _CONNECTIONS  # beyond it, a client that connects waits for a second or more
    )

    def __init__(self, address: tuple[str, int]) -> None:
        self._ends: dict[Any, float] = {}
        super().__init__(address, _Handler, logRequests=False)

    def get_request(self) -> tuple[Any, Any]:
        try:
            return super().get_request()
        except OSError:  # such as no descriptors: the socket stays ready, and would be asked again
            time.sleep(_PAUSE_SECONDS)
            raise

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, where there is one to be had."""
        if len(self._ends) >= _CONNECTIONS:
            self.shutdown_request(request)
            return
        self._ends[request] = time.monotonic() + _CONNECTION_SECONDS
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self._ends.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """End connections whose time is over; called again and again while the server runs."""
        self._end_those_due(time.monotonic())

    def server_close(self) -> None:
        """Close the server and what is connected."""
        super().server_close()
        self._end_those_due(math.inf)

    def _end_those_due(self, now: float) -> None:
        for request, end in list(self._ends.items()):
            if now >= end:
                with suppress(OSError):
                    request.shutdown(socket.SHUT_RDWR)  # its thread notices, and closes it

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log what went wrong with a connection; the standard library prints a traceback."""
        del request, client_address
        _log.debug("XML-RPC: a connection broke: %s", text_of(sys.exc_info()[1] or OSError()))

    def _marshaled_dispatch(self, data: Any, dispatch_method: Any = None, path: Any = None) -> Any:
        """Answer the octets of a request; a document type declaration, as of bombs, is refused."""
        del path
        try:
            _refuse_declarations(data)
        except (ValueError, ExpatError) as error:
            return dumps(Fault(1, f"not a request: {error}"), allow_none=True).encode()
        return super()._marshaled_dispatch(data, dispatch_method)


def _refuse_declarations(data: bytes) -> None:
    """Raise ValueError for XML with a document type declaration, in whatever encoding it stands."""
    parser = ParserCreate()

    def refuse(*_: object) -> None:
        raise ValueError("document type declarations are not taken")

    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(data, True)
