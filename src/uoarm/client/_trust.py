"""Trust in one certificate, known by its fingerprint, where no authority stands behind it."""

from __future__ import annotations

import hashlib
import hmac
import ssl
from urllib.parse import urlsplit

from uoarm.errors import UsageError

__all__ = ["trust_fingerprint"]

_PORT = 443


def trust_fingerprint(url: str, fingerprint: str, *, timeout: float = 10.0) -> ssl.SSLContext:
    """Return a TLS context that trusts the certificate of this server, and no other.

    The server is asked for its certificate once, over a connection of its own on which nothing
    else is told. Blocks.

    Args:
        url: `wss://HOST:PORT/`.
        fingerprint: SHA-256 of its certificate as `uoarm serve --tls auto` prints it and browsers
            show it: 64 hexadecimal digits, colons between them or not.
        timeout: seconds for asking.

    Raises:
        UsageError: the fingerprint or the address is none.
        ssl.SSLCertVerificationError: the server has another certificate.
        OSError: nobody listens there, or no TLS is spoken.
    """
    wanted = fingerprint.replace(":", "").lower()
    if len(wanted) != hashlib.sha256().digest_size * 2 or set(wanted) - set("0123456789abcdef"):
        raise UsageError(f"fingerprint: expected SHA-256, 64 hexadecimal digits, got {fingerprint}")
    certificate = ssl.get_server_certificate(_place(url), timeout=timeout)
    digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(certificate)).hexdigest()
    if not hmac.compare_digest(digest, wanted):
        error = ssl.SSLCertVerificationError("the server's certificate is another")
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
