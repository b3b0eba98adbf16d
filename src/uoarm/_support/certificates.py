"""Certificates for bridge hosts on other machines: a small authority of the robot's own.

A folder holds the authority (`ca.pem`, `ca.key`) and for every name `NAME.pem` and `NAME.key`.
The manager's certificate is good for listening only, a machine's for joining only, so that no
machine can stand in for the manager.

Needs the extra `uoarm[certificates]`.
"""

from __future__ import annotations

import datetime as dt
import ipaddress
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from attrs import frozen
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
)
from cryptography.x509.oid import ExtendedKeyUsageOID

from uoarm._raised import on_failure, reason_of
from uoarm._support.files import write_whole
from uoarm.errors import UsageError

MANAGER = "manager"
"""The name of the manager's certificate."""
_AUTHORITY = "ca"
_SUBJECT = "uoarm robot"
_ADDRESS = re.compile(r"[A-Za-z0-9._:-]+")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")  # 64: the longest common name of X.509
_AUTHORITY_DAYS = 3650
_CLOCKS_DIFFER = dt.timedelta(hours=1)
_COMMON_NAME = "uoarm serve"


def new_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def secret_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a key as PEM, not encrypted."""
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def common_name(name: str) -> x509.Name:
    """Return the subject that consists of a common name."""
    return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])


def begun(
    name: str,
    issuer: x509.Name,
    public: ec.EllipticCurvePublicKey,
    begins: datetime,
    ends: datetime,
) -> x509.CertificateBuilder:
    """Return a certificate without any extension, for a common name."""
    return (
        x509.CertificateBuilder()
        .subject_name(common_name(name))
        .issuer_name(issuer)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins)
        .not_valid_after(ends)
    )


def leaf(
    certificate: x509.CertificateBuilder,
    names: Iterable[str],
    usage: x509.ObjectIdentifier,
    issuer: ec.EllipticCurvePublicKey,
) -> x509.CertificateBuilder:
    """Make a certificate one of a server or client: for these names and addresses, and one use.

    Raises:
        ValueError: a name is none.
    """
    alternatives = x509.SubjectAlternativeName([_general_name(name) for name in names])
    authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer)
    return (
        certificate.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(alternatives, critical=False)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
        .add_extension(key_usage(signs_certificates=False), critical=True)
        .add_extension(authority, critical=False)
    )


def key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    """Return the use of a key: it signs certificates, or what is said in a connection."""
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def check_address(address: str) -> None:
    """Refuse what cannot be the address of a manager.

    Raises:
        UsageError: it is neither an IP address nor a name.
    """
    if not _ADDRESS.fullmatch(address):
        text = "expected an IP address, or a name in ASCII (xn--... for any other)"
        raise UsageError(f"the manager cannot be reached at {address!r}: {text}")


def check_machine(name: str) -> None:
    """Refuse what cannot be the name of a machine.

    Raises:
        UsageError: it is none.
    """
    if not _NAME.fullmatch(name) or name in {_AUTHORITY, MANAGER}:
        raise UsageError(
            f"a machine cannot be called {name!r}: letters, digits, _ and -, a letter or _ "
            f"first, 64 at most, and neither {_AUTHORITY!r} nor {MANAGER!r}"
        )


@frozen
class Authority:
    """Who signs the certificates of one robot.

    Attributes:
        folder: where all its files are.
        certificate: its own.
        key: signs; its owner can make machines and managers.
    """

    folder: Path
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @classmethod
    def of(cls, folder: Path) -> Authority:
        """Return the authority of a folder; make both where there is none.

        Raises:
            UsageError: the folder cannot be used, or its authority not be read.
        """
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if (folder / f"{_AUTHORITY}.pem").exists():
                return cls._read(folder)
            return cls._make(folder)
        except (OSError, ValueError, TypeError) as error:
            # A TypeError is the library's for a key with a passphrase.
            why = error if isinstance(error, TypeError) else reason_of(error, folder)
            raise UsageError(f"{folder} cannot hold certificates: {why}") from error

    def certify_manager(self, addresses: Sequence[str], days: int) -> Path:
        """Make the manager's certificate, for the addresses under which machines reach it.

        Raises:
            UsageError: there is one already, an address is none, or it cannot be written.
        """
        for address in addresses:
            check_address(address)
        return self._certify(MANAGER, addresses, ExtendedKeyUsageOID.SERVER_AUTH, days)

    def certify_machine(self, name: str, days: int) -> Path:
        """Make the certificate of a machine.

        Raises:
            UsageError: there is one already, no machine can have this name, or it cannot be
                written.
        """
        check_machine(name)
        return self._certify(name, [name], ExtendedKeyUsageOID.CLIENT_AUTH, days)

    def _certify(
        self, name: str, names: Sequence[str], usage: x509.ObjectIdentifier, days: int
    ) -> Path:
        place = self.folder / f"{name}.pem"
        for file in (place, place.with_suffix(".key")):
            if file.exists():
                text = "remove the certificate and its key to make new ones"
                raise UsageError(f"{file} is there already: {text}")
        key = new_key()
        try:
            certificate = begun(name, self.certificate.subject, key.public_key(), *_span(days))
            issued = leaf(certificate, names, usage, self.key.public_key())
            _write(self.folder, name, issued.sign(self.key, hashes.SHA256()), key)
        except (OSError, ValueError, OverflowError) as error:
            raise UsageError(f"{place} cannot be made: {reason_of(error, place)}") from error
        return place

    @classmethod
    def _read(cls, folder: Path) -> Authority:
        certificate = (folder / f"{_AUTHORITY}.pem").read_bytes()
        key = (folder / f"{_AUTHORITY}.key").read_bytes()
        signs = serialization.load_pem_private_key(key, None)
        if not isinstance(signs, ec.EllipticCurvePrivateKey):
            raise UsageError(f"{folder / _AUTHORITY}.key is no key of an elliptic curve")
        return cls(folder, x509.load_pem_x509_certificate(certificate), signs)

    @classmethod
    def _make(cls, folder: Path) -> Authority:
        key = new_key()
        public = key.public_key()
        certificate = (
            begun(_SUBJECT, common_name(_SUBJECT), public, *_span(_AUTHORITY_DAYS))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(key_usage(signs_certificates=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
            .sign(key, hashes.SHA256())
        )
        _write(folder, _AUTHORITY, certificate, key)
        return cls(folder, certificate, key)


def _span(days: int) -> tuple[dt.datetime, dt.datetime]:
    now = dt.datetime.now(dt.timezone.utc)
    return now - _CLOCKS_DIFFER, now + dt.timedelta(days=days)


def _write(
    folder: Path, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey
) -> None:
    """Write a pair, both or none; the key first, and never readable for others."""
    key_file = folder / f"{name}.key"
    write_whole(key_file, secret_pem(key), private=True)
    with on_failure(key_file.unlink, missing_ok=True):
        write_whole(folder / f"{name}.pem", certificate.public_bytes(serialization.Encoding.PEM))


@frozen
class CertificateFacts:
    """What a certificate says.

    Attributes:
        names: names and addresses that it is for.
        begins: from when on it holds.
        ends: when it ends.
    """

    names: frozenset[str]
    begins: datetime
    ends: datetime


def make(names: Iterable[str], begins: datetime, ends: datetime) -> bytes:
    """Return a new key and its certificate as PEM.

    Raises:
        ValueError: a name is none.
    """
    key = new_key()
    public = key.public_key()
    certificate = leaf(
        begun(_COMMON_NAME, common_name(_COMMON_NAME), public, begins, ends),
        names,
        ExtendedKeyUsageOID.SERVER_AUTH,
        public,
    )
    identifier = x509.SubjectKeyIdentifier.from_public_key(public)
    signed = certificate.add_extension(identifier, critical=False).sign(key, hashes.SHA256())
    return secret_pem(key) + signed.public_bytes(Encoding.PEM)


def read(pem: bytes) -> CertificateFacts | None:
    """Return what a certificate says, None where there is none that can be read."""
    names = x509.SubjectAlternativeName([])
    try:
        certificate = x509.load_pem_x509_certificate(pem)
        with suppress(x509.ExtensionNotFound):
            names = certificate.extensions.get_extension_for_class(type(names)).value
    except ValueError:
        return None
    hosts = names.get_values_for_type(x509.DNSName)
    addresses = [str(value) for value in names.get_values_for_type(x509.IPAddress)]
    return CertificateFacts(
        frozenset([*hosts, *addresses]),
        certificate.not_valid_before_utc,
        certificate.not_valid_after_utc,
    )
