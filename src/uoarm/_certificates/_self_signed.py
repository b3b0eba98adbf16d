"""Making and reading the self-signed certificate of a server."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

from attrs import frozen
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from uoarm._certificates._parts import begun, common_name, leaf, new_key, secret_pem

__all__ = ["Found", "make", "read"]

_NAME = "uoarm serve"


@frozen
class Found:
    """What a certificate says.

    Attributes:
        names: names and addresses that it is for.
        ends: when it ends.
    """

    names: frozenset[str]
    ends: datetime


def make(names: Iterable[str], begins: datetime, ends: datetime) -> bytes:
    """Return a new key and its certificate as PEM.

    Raises:
        ValueError: a name is none.
    """
    key = new_key()
    public = key.public_key()
    certificate = leaf(
        begun(_NAME, common_name(_NAME), public, begins, ends),
        names,
        ExtendedKeyUsageOID.SERVER_AUTH,
        public,
    )
    identifier = x509.SubjectKeyIdentifier.from_public_key(public)
    signed = certificate.add_extension(identifier, critical=False).sign(key, hashes.SHA256())
    return secret_pem(key) + signed.public_bytes(Encoding.PEM)


def read(pem: bytes) -> Found | None:
    """Return what a certificate says, None where there is none that can be read."""
    try:
        certificate = x509.load_pem_x509_certificate(pem)
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (ValueError, x509.ExtensionNotFound):
        return None
    hosts = names.get_values_for_type(x509.DNSName)
    addresses = [str(value) for value in names.get_values_for_type(x509.IPAddress)]
    return Found(frozenset([*hosts, *addresses]), certificate.not_valid_after_utc)
