"""Where a server is, which certificate it has, and the way to its robot."""

from __future__ import annotations

import hashlib
import hmac
import ssl
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from types import MappingProxyType
from urllib.parse import urlsplit

from attrs import field, frozen

from uoarm._arguments import arguments
from uoarm._secrets import without_secrets
from uoarm._wire import BINARY_FORM, LARGEST, TEXT_FORM, Form
from uoarm.client._client import RemoteRobot
from uoarm.client._socket import ClientSocket
from uoarm.errors import UsageError

_PORT = 443


@frozen
class ServerAddress:
    """Where a server is, and how it is greeted.

    Attributes:
        url: `ws://` or `wss://`.
        token: shown in the handshake; None: none is.
        tls: for `wss://`, where the system's authorities do not do; or what returns it for each
            attempt to connect.
        timeout: seconds for connecting.
        silence: seconds without a sign of life after which the connection counts as dropped.
        headers: further ones of the handshake.
        answer: seconds after which an answer comes no more, beyond those that the question gives
            it: the `timeout` of a call, the `wait` of a request.
    """

    url: str
    token: str | None = field(default=None, repr=False)
    tls: ssl.SSLContext | Callable[[], ssl.SSLContext] | None = None
    timeout: float = 10.0
    silence: float = 20.0
    headers: Mapping[str, str] = MappingProxyType({})
    answer: float = 120.0

    def robot(
        self,
        *,
        binary: bool = True,
        reconnect: float = 0.0,
        on_link: Callable[[str], object] = str,
        place: str = "the server",
    ) -> RemoteRobot:
        """Return what connects there for the length of `async with robot.running(resume=True)`.

        Args:
            binary: CBOR; False: JSON.
            reconnect: as of `connect`.
            on_link: called in the loop with why the connection dropped, at once, and with "" when
                messages pass again.
            place: the server, as errors name it.
        """
        form = BINARY_FORM if binary else TEXT_FORM
        opening = partial(self._open, form)
        return RemoteRobot(opening, form, reconnect, on_link, self.answer, place)

    async def _open(self, form: Form) -> ClientSocket:
        headers = dict(self.headers)
        if self.token is not None:
            token = self.token.strip()  # as it is read from a file
            if not token.isprintable():  # what `websockets` raises would show it
                raise UsageError("token: expected one line of visible characters")
            headers["Authorization"] = f"Bearer {token}"
        limits = {"timeout": self.timeout, "silence": self.silence}
        tls = self.tls() if callable(self.tls) else self.tls
        return await ClientSocket.open(self.url, form, headers, tls, LARGEST.octets, **limits)


@arguments()
@asynccontextmanager
async def connect(
    url: str,
    *,
    token: str | None = None,
    binary: bool = True,
    tls: ssl.SSLContext | None = None,
    timeout: float = 10.0,
    resume: bool = True,
    reconnect: float = 60.0,
    answer: float = 120.0,
) -> AsyncIterator[RemoteRobot]:
    """Connect to a server for the length of a block.

    Args:
        url: `ws://` or `wss://`.
        token: shown in the handshake.
        binary: CBOR, where octets stay octets; False: JSON.
        tls: for `wss://`, where the system's authorities do not do: `trust_fingerprint` makes one
            for a certificate that the server made itself.
        timeout: seconds for connecting.
        resume: whether to connect again after a drop and go on with the same session, as long as
            the server keeps it; what was lost meanwhile is in `RemoteStream.lost`.
        reconnect: seconds for which it is tried to begin a new session where that one is gone, as
            after a restart of the server, and to open what was open; `RemoteStream.gaps` counts
            it. What waited for an answer fails; no command is repeated. 0: everything fails.
        answer: seconds after which an answer comes no more, beyond those that the question gives
            it: the `timeout` of a call, the `wait` of a request.

    Raises:
        OSError: no server listens there.
        ssl.SSLCertVerificationError: the server's certificate is not trusted.
        TimeoutError: it took too long.
        websockets.exceptions.InvalidHandshake: the server refused, for example without a token.
        UsageError: the address or the token is none.
    """
    server = ServerAddress(url, token, tls, timeout, answer=answer)
    made = server.robot(
        binary=binary, reconnect=reconnect, place=f"the server at {without_secrets(url)}"
    )
    async with made.running(resume=resume) as robot:
        yield robot


def trust_fingerprint(url: str, fingerprint: str, *, timeout: float = 10.0) -> ssl.SSLContext:
    """Return a TLS context that trusts the certificate of this server, and no other.

    The server is asked for its certificate once, over a connection of its own on which nothing
    else is said. Blocks.

    Args:
        url: `wss://HOST:PORT/`.
        fingerprint: SHA-256 of its certificate as `uoarm serve --tls auto` prints it and browsers
            show it: 64 hexadecimal digits, colons between them or not.
        timeout: seconds for asking.

    Raises:
        UsageError: the fingerprint or the address is none.
        ssl.SSLCertVerificationError: the server has another certificate.
        OSError: no server listens there, or no TLS is spoken.
    """
    wanted = fingerprint.replace(":", "").lower()
    if len(wanted) != hashlib.sha256().digest_size * 2 or set(wanted) - set("0123456789abcdef"):
        raise UsageError(f"fingerprint: expected SHA-256, 64 hexadecimal digits, got {fingerprint}")
    certificate = ssl.get_server_certificate(_place(url), timeout=timeout)
    digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(certificate)).hexdigest()
    if not hmac.compare_digest(digest, wanted):
        error = ssl.SSLCertVerificationError(1, "the server's certificate is another")
        error.verify_message = f"its fingerprint is {digest}, not the one that is wanted"
        raise error
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False  # the certificate itself is known, whatever names it has
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    context.load_verify_locations(cadata=certificate)
    return context


def _place(url: str) -> tuple[str, int]:
    address = urlsplit(url)
    try:
        port = address.port or _PORT
    except ValueError:  # beyond 65535
        port = None
    if address.scheme != "wss" or not address.hostname or port is None:
        wanted = "expected wss://HOST:PORT/"
        raise UsageError(f"a fingerprint is of a server with TLS: {wanted}, got {url}")
    return address.hostname, port
