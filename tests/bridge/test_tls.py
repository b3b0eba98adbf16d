"""The one home of TLS contexts: what is refused names the file, for clients and servers alike."""

from __future__ import annotations

import os
import re
import ssl
from contextlib import suppress
from datetime import datetime, timedelta, timezone
from functools import partial
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509 import BasicConstraints

from uoarm._support.certificates import begun, common_name, new_key, secret_pem
from uoarm._support.tls import client_context, server_context
from uoarm.bridge import TlsOptions, tls_fault
from uoarm.errors import ConfigurationError
from uoarm.server.http import own_certificate


@pytest.fixture
def certificate(tmp_path: Path) -> Path:
    return own_certificate(tmp_path, ("localhost",))


def test_a_client_checks_certificate_and_name(certificate: Path) -> None:
    context = TlsOptions(ca=str(certificate)).context("b")
    assert (context.verify_mode, context.check_hostname) == (ssl.CERT_REQUIRED, True)
    assert context.minimum_version >= ssl.TLSVersion.TLSv1_2


def test_a_client_can_show_a_certificate(certificate: Path) -> None:
    assert TlsOptions(None, str(certificate)).context("b").verify_mode is ssl.CERT_REQUIRED


def test_a_server_asks_for_certificates_where_it_has_an_authority(certificate: Path) -> None:
    assert server_context(certificate).verify_mode is ssl.CERT_NONE
    assert server_context(certificate, None, certificate).verify_mode is ssl.CERT_OPTIONAL


def test_a_server_gives_no_ticket_that_meets_what_a_client_writes(certificate: Path) -> None:
    into, out = ssl.MemoryBIO(), ssl.MemoryBIO()
    server = server_context(certificate).wrap_bio(into, out, server_side=True)
    client = client_context(certificate).wrap_bio(out, into, server_hostname="localhost")
    for end in (client, server, client, server):
        with suppress(ssl.SSLWantReadError):
            end.do_handshake()
    assert server.version() == "TLSv1.3"
    assert out.pending == 0, "something comes after the handshake"


@pytest.mark.parametrize("trusted", ["authority", "server"])
def test_a_certificate_by_the_manual_of_a_broker_is_trusted(tmp_path: Path, trusted: str) -> None:
    """The authority does not say what its key is for, and the server's has no extension at all."""
    now = datetime.now(timezone.utc)
    key, server_key = new_key(), new_key()
    issuer, span = common_name("authority"), timedelta(days=1)
    made = begun("authority", issuer, key.public_key(), now - span, now + span)
    authority = made.add_extension(BasicConstraints(ca=True, path_length=None), critical=True)
    server = begun("localhost", issuer, server_key.public_key(), now - span, now + span)
    for name, certificate in (("authority", authority), ("server", server)):
        octets = certificate.sign(key, SHA256()).public_bytes(Encoding.PEM)
        (tmp_path / f"{name}.pem").write_bytes(octets)
    (tmp_path / "server.key").write_bytes(secret_pem(server_key))
    shown = server_context(tmp_path / "server.pem", tmp_path / "server.key")
    into, out = ssl.MemoryBIO(), ssl.MemoryBIO()
    served = shown.wrap_bio(into, out, server_side=True)
    client = client_context(tmp_path / f"{trusted}.pem").wrap_bio(
        out, into, server_hostname="localhost"
    )
    for end in (client, served, client, served):
        with suppress(ssl.SSLWantReadError):
            end.do_handshake()
    assert client.version() == served.version() == "TLSv1.3"


def test_a_file_that_is_not_there_is_named(tmp_path: Path, certificate: Path) -> None:
    missing = tmp_path / "no.pem"
    for authority, shown in ((missing, None), (None, missing)):
        with pytest.raises(ConfigurationError, match=r"TLS: .*no\.pem: .*No such file"):
            client_context(authority, shown)
    for shown, authority in ((missing, None), (certificate, missing)):
        with pytest.raises(ConfigurationError, match=r"TLS: .*no\.pem: .*No such file"):
            server_context(shown, None, authority)


def test_no_pipe_is_waited_for(tmp_path: Path, certificate: Path) -> None:
    pipe = tmp_path / "pipe.pem"
    os.mkfifo(pipe)
    for authority, shown in ((pipe, None), (None, pipe)):
        with pytest.raises(ConfigurationError, match=r"TLS: .*pipe\.pem: .*not a regular file"):
            client_context(authority, shown)
    for files in ((pipe, None, None), (certificate, pipe, None), (certificate, None, pipe)):
        with pytest.raises(ConfigurationError, match=r"TLS: .*pipe\.pem: .*not a regular file"):
            server_context(*files)


def test_what_a_pair_lacks_is_said(tmp_path: Path, certificate: Path) -> None:
    lines = certificate.read_text().splitlines(keepends=True)
    at = lines.index("-----BEGIN CERTIFICATE-----\n")
    alone, key, secret = tmp_path / "alone.pem", tmp_path / "own.key", tmp_path / "secret.key"
    alone.write_text("".join(lines[at:]))
    key.write_text("".join(lines[:at]))
    made = load_pem_private_key(key.read_bytes(), None)
    secret.write_bytes(
        made.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"x"))
    )
    for pair, text in (
        ((alone, None), f"there is no private key in {alone}: name the file of its key as well"),
        ((key, alone), f"there is no certificate in {key}"),
        ((alone, alone), f"there is no private key in {alone}"),
        ((alone, secret), "the key has a passphrase: only one without is used"),
    ):
        for show in (partial(client_context, None), server_context):
            with pytest.raises(ConfigurationError, match=text):
                show(*pair)
    server_context(alone, key)
    with pytest.raises(ConfigurationError, match="the certificate of this key is missing"):
        client_context(key=key)


@pytest.mark.parametrize("encryption", [NoEncryption(), BestAvailableEncryption(b"x")])
def test_a_key_of_another_or_with_a_passphrase_is_refused_without_asking(
    tmp_path: Path, certificate: Path, encryption: NoEncryption | BestAvailableEncryption
) -> None:
    key = tmp_path / "other.pem"
    key.write_bytes(new_key().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption))
    for show in (partial(client_context, None), server_context):
        with pytest.raises(ConfigurationError, match=f"{certificate} with {key}: "):
            show(certificate, key)


def test_the_error_of_a_bridge_names_it(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"bridge 'b': tls: .*no\.pem: "):
        TlsOptions(str(tmp_path / "no.pem")).context("b")


@pytest.mark.parametrize(
    ("host", "certified", "why"),
    [
        ("localhost", True, "its certificate is not trusted: self.signed certificate; trust it"),
        ("another", False, r"its certificate is not trusted: .*; connect by a name that it has"),
        ("localhost", None, "no TLS is spoken there: wrong version number"),
    ],
)
def test_why_tls_failed_is_said_in_words(
    certificate: Path, host: str, certified: bool | None, why: str
) -> None:
    into, out = ssl.MemoryBIO(), ssl.MemoryBIO()
    server = server_context(certificate).wrap_bio(into, out, server_side=True)
    client = client_context(None if certified else certificate).wrap_bio(
        out, into, server_hostname=host
    )
    with suppress(ssl.SSLWantReadError):
        client.do_handshake()
    if certified is None:
        out.write(b"HTTP/1.1 400 Bad Request")
    else:
        with suppress(ssl.SSLWantReadError):
            server.do_handshake()
    with pytest.raises(ssl.SSLError) as raised:
        client.do_handshake()
    assert re.fullmatch(why, tls_fault(raised.value, "trust it"))
    # As OpenSSL says in words of a release of TLS what a side thinks of the other's certificate.
    ours = ssl.SSLError(1, "[SSL: TLSV1_ALERT_UNKNOWN_CA] tlsv1 alert unknown ca")
    assert "no TLS: it says of this side's certificate: " in tls_fault(ours)
    assert tls_fault(ConnectionResetError("gone")) == "gone"
    assert tls_fault(ConnectionResetError()) == "no TLS: it ended the connection"
