"""How the server is set up, checked before anything listens."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from pathlib import Path

from attrs import field, frozen

from uoarm._support.files import user_folder
from uoarm.errors import ConfigurationError
from uoarm.model import is_loopback
from uoarm.server._limits import Limits
from uoarm.server.http import ShownCertificate, own_certificate


def _absolute(path: Path | None) -> Path | None:
    """Return a path that stays the same where the program changes its folder: it is read again."""
    return None if path is None else path.absolute()


@frozen
class ServerOptions:
    """Where the server listens and whom it lets in.

    Attributes:
        host: address to listen on.
        port: 0 for any that is free.
        front_end_ports: further ports by name of a front end, whose endpoint every path is there.
        access: access file with roles and tokens; needed off loopback.
        origins: origins of web pages that may connect, `*` for all.
        hosts: further names by which the server is reached on loopback.
        certificate: PEM file of the server's certificate and chain, for TLS.
        own_certificate: make one where there is none, and keep it for this user.
        key: PEM file of its key; None: in the same file.
        client_authority: PEM file of the authority whose client certificates are asked for.
        deflate: compress texts of 512 octets to 32 KiB for clients that ask for it (RFC 7692).
        recordings: folder of what clients record; None: one of this user's state.
        audit: file that the audit log is appended to; None: it goes to the logger alone.
        limits: bounds of what clients may use.
    """

    host: str = "127.0.0.1"
    port: int = 9080
    front_end_ports: Mapping[str, int] = field(factory=dict, hash=False)
    access: Path | None = field(default=None, converter=_absolute)
    origins: tuple[str, ...] = ()
    hosts: tuple[str, ...] = ()
    certificate: Path | None = field(default=None, converter=_absolute)
    own_certificate: bool = False
    key: Path | None = field(default=None, converter=_absolute)
    client_authority: Path | None = field(default=None, converter=_absolute)
    deflate: bool = False
    recordings: Path | None = field(default=None, converter=_absolute)
    audit: Path | None = field(default=None, converter=_absolute)
    limits: Limits = field(factory=Limits)

    @property
    def local(self) -> bool:
        """Whether only this machine can reach the server."""
        return is_loopback(self.host)

    @property
    def everywhere(self) -> bool:
        """Whether the host names every address of this machine, and none to connect to."""
        try:
            return not self.host or ipaddress.ip_address(self.host).is_unspecified
        except ValueError:
            return False

    def place(self, port: int) -> str:
        """Return `host:port` as it stands in a URL."""
        return _place(self.host, port)

    def place_from_here(self, port: int) -> str:
        """Return `host:port` of a URL that can be opened on this machine."""
        if not self.everywhere:
            return self.place(port)
        return _place("::1" if ":" in self.host else "127.0.0.1", port)

    def check(self) -> None:
        """Refuse settings that would let the network in unasked.

        Raises:
            ConfigurationError: it listens off loopback without an access file, asks for client
                certificates without TLS, or has a key without its certificate.
        """
        if not self.local and self.access is None:
            raise ConfigurationError(
                f"{self.host} can be reached from other machines: give an access file "
                "(--access), or listen on 127.0.0.1"
            )
        if self.own_certificate and (self.certificate is not None or self.key is not None):
            raise ConfigurationError(
                "--tls auto makes a certificate: leave --certificate and --key out"
            )
        if self.key is not None and self.certificate is None:
            raise ConfigurationError("--key is that of --certificate, which is missing")
        if self.client_authority is not None and not self.secured:
            raise ConfigurationError(
                "client certificates need TLS: give --certificate or --tls auto as well"
            )

    @property
    def recordings_folder(self) -> Path:
        """Where files go that clients record."""
        return self.recordings or user_folder("state") / "recordings"

    @property
    def secured(self) -> bool:
        """Whether TLS is spoken."""
        return self.certificate is not None or self.own_certificate

    def certificate_file(self) -> Path | None:
        """Return the file of the certificate, made at need; None without TLS.

        Raises:
            ConfigurationError: it cannot be made or kept.
        """
        if not self.own_certificate:
            return self.certificate
        names = self.hosts if self.everywhere else (self.host, *self.hosts)
        return own_certificate(user_folder("state") / "tls", names)

    def shown_certificate(self) -> ShownCertificate | None:
        """Return what connections are shown, None without TLS.

        Raises:
            ConfigurationError: a file cannot be used.
        """
        path = self.certificate_file()
        if path is None:
            return None
        own = self.own_certificate
        return ShownCertificate(path, self.key, self.client_authority, is_printed=own)


def _place(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
