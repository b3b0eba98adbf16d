"""The contexts of TLS, for whatever speaks it: one set of rules, and of errors that name the file.

Nothing older than TLS 1.2 is spoken. No passphrase is asked for on a terminal: a key that has one
is refused.
"""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TypeAlias

from uoarm._raised import reason_of
from uoarm._support.files import mode_of_regular
from uoarm.errors import ConfigurationError

_File: TypeAlias = "str | PathLike[str]"


def client_context(
    authority: _File | None = None,
    certificate: _File | None = None,
    key: _File | None = None,
    *,
    what: str = "TLS",
) -> ssl.SSLContext:
    """Return the context of a client, which checks the server's certificate and name.

    Args:
        authority: PEM file that the server's certificate rests on; None: the system's.
        certificate: PEM file that the server is shown.
        key: of the certificate; None: in the same file.
        what: is set up, as errors name it.

    Raises:
        ConfigurationError: a file cannot be used; the text names it.
    """
    with _using(what, authority):
        context = ssl.create_default_context(cafile=authority)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    # As from CPython 3.13 on: what the file has is trusted, be it no authority. As before it: the
    # authorities that OpenSSL makes, by the manuals of brokers, lack what RFC 5280 asks for.
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    if certificate is not None:
        show_certificate(context, certificate, key, what=what)
    elif key is not None:
        raise ConfigurationError(f"{what}: {key}: the certificate of this key is missing")
    return context


def server_context(
    certificate: _File, key: _File | None = None, authority: _File | None = None
) -> ssl.SSLContext:
    """Return the context of a server.

    Args:
        certificate: PEM file that clients are shown.
        key: of the certificate; None: in the same file.
        authority: PEM file that certificates of clients rest on, where they show one; None: clients
            are asked for none.

    Raises:
        ConfigurationError: a file cannot be used; the text names it.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    # A ticket comes right after the handshake. A client that writes in one thread as another reads
    # it may lose the answer: 12 of 9,860 connections of websockets' threads did, without one 0 of
    # 37,654. Nothing of ours resumes a session.
    context.num_tickets = 0
    show_certificate(context, certificate, key)
    if authority is not None:
        with _using("TLS", authority):
            context.load_verify_locations(authority)
        context.verify_mode = ssl.CERT_OPTIONAL
    return context


def show_certificate(
    context: ssl.SSLContext, certificate: _File, key: _File | None = None, *, what: str = "TLS"
) -> None:
    """Have a context show a certificate.

    Raises:
        ConfigurationError: a file cannot be used; the text names it.
    """
    with _using(what, certificate, key):
        try:
            context.load_cert_chain(certificate, key, password=lambda: b"")
        except ssl.SSLError as error:
            raise ValueError(_fault(certificate, key) or error) from error


def _fault(certificate: _File, key: _File | None) -> str:
    """Say what is wrong with files of which OpenSSL says no more than that it is."""
    if b"CERTIFICATE-----" not in Path(certificate).read_bytes():
        return f"there is no certificate in {certificate}"
    secret = Path(key or certificate).read_bytes()
    if b"PRIVATE KEY-----" not in secret:
        return f"there is no private key in {key or certificate}" + (
            "" if key else ": name the file of its key as well"
        )
    if b"ENCRYPTED" in secret:
        return "the key has a passphrase: only one without is used"
    return ""


@contextmanager
def _using(what: str, *files: _File | None) -> Iterator[None]:
    try:
        for file in files:
            if file is not None:  # OpenSSL would wait for who writes into a pipe
                mode_of_regular(Path(file))
        yield
    except (OSError, ValueError) as error:  # of a wrong passphrase ValueError
        why = reason_of(error, files[0])
        names = " with ".join(str(file) for file in files if file is not None)
        raise ConfigurationError(f"{what}: {names or 'the system'}: {why}") from error
