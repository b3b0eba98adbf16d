"""The structure database of a bridge over XML-RPC, for tools that speak nothing else."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable
from http import HTTPStatus
from socketserver import ThreadingMixIn
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, to_json

__all__ = ["XmlRpcFace"]

_LOOPBACK = "127.0.0.1"
_LARGEST = 64 * 1024
_DESCRIBE_SECONDS = 10.0
_REQUEST_SECONDS = 10.0


class XmlRpcFace:
    """Answers what a bridge knows of its endpoints; read-only, on the loopback interface only.

    Methods: `components()` names those of the configuration; `ports(component)` their ports;
    `structure(component, port)` returns a port's structures as JSON text, since XML-RPC has
    neither null nor integers above 32 bits; `discover()` lists what is visible now.

    Args:
        bridge: asked anew for every request.
        endpoints: of the components in the configuration.
        port: to listen on; 0: any free one.

    Raises:
        BridgeError: the port cannot be had.
    """

    def __init__(self, bridge: Bridge, endpoints: Iterable[Endpoint], port: int = 0) -> None:
        try:
            self._server = _Server((_LOOPBACK, port), _Handler, logRequests=False)
        except OSError as error:
            text = f"XML-RPC cannot listen on port {port} of {_LOOPBACK}: {error}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        self._server.register_instance(_Database(bridge, endpoints))
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.1,), name="uoarm-xmlrpc", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that it listens on."""
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
        self._endpoints = {(one.component, one.port): one for one in endpoints}

    def components(self) -> list[str]:
        """Return the components of the configuration that this bridge reaches."""
        return sorted({component for component, _ in self._endpoints})

    def ports(self, component: str) -> list[str]:
        """Return the ports of a component."""
        return sorted(port for name, port in self._endpoints if name == component)

    def structure(self, component: str, port: str = "default") -> str:
        """Return the structures of a port as JSON text."""
        endpoint = self._endpoints.get((component, port))
        if endpoint is None:
            text = f"there is no port {port!r} of a component {component!r}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return json.dumps(to_json(self._bridge.describe(endpoint, timeout=_DESCRIBE_SECONDS)))

    def discover(self) -> str:
        """Return the components that are visible now as JSON text."""
        return json.dumps(to_json(list(self._bridge.discover(timeout=_DESCRIBE_SECONDS))))


class _Handler(SimpleXMLRPCRequestHandler):
    """Refuses what is too long, and what a web page was led to send here under another name."""

    timeout = _REQUEST_SECONDS

    def do_POST(self) -> None:  # noqa: N802 - the standard library's name
        """Answer a request."""
        host = self.headers.get("Host", "").rpartition(":")[0]
        length = self.headers.get("Content-Length", "")
        if host not in {_LOOPBACK, "localhost"}:
            self.send_error(HTTPStatus.FORBIDDEN, "only from this machine, by its own name")
        elif not length.isdigit() or int(length) > _LARGEST:
            self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"{_LARGEST} octets at most")
        else:
            super().do_POST()


class _Server(ThreadingMixIn, SimpleXMLRPCServer):
    """One thread a request, so that one that waits for a framework holds up no other."""

    daemon_threads = True
