"""How the server is set up, checked before anything listens."""

from __future__ import annotations

import ssl
from pathlib import Path

from attrs import field, frozen

from uoarm.errors import ConfigurationError
from uoarm.server._admission import is_loopback
from uoarm.server._limits import Limits

__all__ = ["Settings"]


@frozen
class Settings:
    """Where the server listens and whom it lets in.

    Attributes:
        host: address to listen on.
        port: 0 for any that is free.
        rosbridge_port: a second port where every path is the rosbridge endpoint; None: none.
        access: access file with roles and tokens; needed off loopback.
        origins: origins of web pages that may connect, `*` for all.
        hosts: further names by which the server is reached on loopback.
        certificate: PEM file of the server's certificate and chain, for TLS.
        key: PEM file of its key; None: in the same file.
        client_authority: PEM file of the authority whose client certificates are asked for.
        limits: bounds of what clients may use.
    """

    host: str = "127.0.0.1"
    port: int = 9080
    rosbridge_port: int | None = None
    access: Path | None = None
    origins: tuple[str, ...] = ()
    hosts: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None
    client_authority: Path | None = None
    limits: Limits = field(factory=Limits)

    @property
    def local(self) -> bool:
        """Whether only this machine can reach the server."""
        return is_loopback(self.host)

    def check(self) -> None:
        """Refuse settings that would let the network in unasked.

        Raises:
            ConfigurationError: it listens off loopback without an access file, or asks for client
                certificates without TLS.
        """
        if not self.local and self.access is None:
            raise ConfigurationError(
                f"{self.host} can be reached from other machines: give an access file "
                "(--access), or listen on 127.0.0.1"
            )
        if self.client_authority is not None and self.certificate is None:
            raise ConfigurationError("client certificates need TLS: give --certificate as well")

    def tls(self) -> ssl.SSLContext | None:
        """Return the TLS context, None without a certificate.

        Raises:
            ConfigurationError: a file cannot be used.
        """
        if self.certificate is None:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self.certificate, self.key)
            if self.client_authority is not None:
                context.load_verify_locations(self.client_authority)
                context.verify_mode = ssl.CERT_OPTIONAL
        except (OSError, ssl.SSLError) as error:
            raise ConfigurationError(f"TLS: {self.certificate}: {error}") from error
        return context
