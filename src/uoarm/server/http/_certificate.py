"""The certificate that a server shows: made for this user, or read again where it was renewed."""

from __future__ import annotations

import hashlib
import socket
import ssl
import stat
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from uoarm._origin import install_command
from uoarm._raised import Log, reason_of
from uoarm._support.files import stamp_of, write_whole
from uoarm._support.tls import server_context
from uoarm.errors import ConfigurationError

if TYPE_CHECKING:
    from uoarm._support.certificates import CertificateFacts

_log = Log("uoarm.server")
_VALID = timedelta(days=397)
_RENEW_BEFORE = timedelta(days=30)
_EARLIER = timedelta(hours=1)
_ALWAYS = ("localhost", "127.0.0.1", "::1")
_LATE = timedelta(days=14)  # for a renewal; or a third of how long the certificate is good
_UNUSED = "renewed files of TLS are not used, those before are: %s"


class _LatestContext(ssl.SSLContext):
    """Hands each connection to the context made last; what one trusts can only be added to."""

    latest: ssl.SSLContext

    def wrap_bio(self, *arguments: Any, **named: Any) -> ssl.SSLObject:
        """Begin a connection, as asyncio does for each."""
        return self.latest.wrap_bio(*arguments, **named)


class ShownCertificate:
    """What connections are shown and trust: files that are read again where they were renewed.

    Args:
        path: PEM file of the certificate and its chain.
        key: PEM file of its key; None: in the same file.
        authority: PEM file that certificates of clients rest on; None: they are asked for none.
        is_printed: programs were given its fingerprint: no other takes its place.

    Attributes:
        context: of each connection.

    Raises:
        ConfigurationError: a file cannot be used.
    """

    def __init__(
        self, path: Path, key: Path | None, authority: Path | None, *, is_printed: bool = False
    ) -> None:
        self._is_printed = is_printed
        self._path, self._key, self._authority = path, key, authority
        self._stamps = self._look()
        self.context = _LatestContext(ssl.PROTOCOL_TLS_SERVER)
        self.context.latest = server_context(path, key, authority)
        self._facts = _maker().read(path.read_bytes())
        self._warned = ""

    def refresh(self) -> None:
        """Have new connections use what the files hold now; mistakes are logged, once.

        Blocks while it reads: called in a thread of its own, one call at a time.
        """
        stamps = self._look()
        # Another server of this user may have made it anew.
        is_another = self._is_printed and stamps[0] != self._stamps[0]
        if is_another:
            stamps = (self._stamps[0], *stamps[1:])
        if stamps == self._stamps:
            return
        self._stamps = stamps
        if is_another:
            _log.error(_UNUSED, f"{self._path} was made anew: restart the server")
            return
        try:
            self.context.latest = server_context(self._path, self._key, self._authority)
        except ConfigurationError as error:
            _log.error(_UNUSED, error)
            return
        self._facts = _maker().read(self._path.read_bytes())
        self._warned = ""
        digest = fingerprint_of(self._path)
        _log.info("files of TLS were renewed; certificate %s, SHA-256 %s", self._path, digest)

    def warn(self, now: datetime | None = None) -> None:
        """Log once that the certificate ends soon, and once that it has ended."""
        facts, moment = self._facts, now or datetime.now(timezone.utc)
        if facts is None or facts.ends - moment > min(_LATE, (facts.ends - facts.begins) / 3):
            return
        ends = "ends" if moment < facts.ends else "has ended"
        if ends != self._warned:
            self._warned = ends
            at = f"{facts.ends:%Y-%m-%dT%H:%M:%SZ}"
            text = "certificate %s %s at %s, from when on clients refuse it: renew the file"
            _log.warning(text, self._path, ends, at)

    def _look(self) -> tuple[tuple[int, ...], ...]:
        files = self._path, self._key, self._authority
        return tuple(stamp_of(path) for path in files if path is not None)


def own_certificate(folder: Path, names: Sequence[str], now: datetime | None = None) -> Path:
    """Return a PEM file with a key and a self-signed certificate, made when there is none to use.

    It is kept for over a year, so that clients may pin it, and made anew when it soon ends or does
    not name the server. It keeps the names that it had: several servers of this user share it.

    Args:
        folder: where it is kept, readable by this user only.
        names: by which clients reach the server, beside those of loopback.
        now: time of day.

    Raises:
        ConfigurationError: it cannot be kept there, others can read it, or the package
            `cryptography` is missing.
    """
    path = folder / "server.pem"
    wanted = list(dict.fromkeys((*_ALWAYS, socket.gethostname(), *names)))
    moment = now or datetime.now(timezone.utc)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = _found(path)
        names_found = frozenset() if found is None else found.names
        if found is None or set(wanted) - names_found or found.ends - moment <= _RENEW_BEFORE:
            every = [*wanted, *sorted(names_found.difference(wanted))]
            made = _maker().make(every, moment - _EARLIER, moment + _VALID)
            write_whole(path, made, private=True)
    except OSError as error:
        raise ConfigurationError(
            f"the server's own certificate: {path}: {reason_of(error, path)}"
        ) from error
    return path


def fingerprint_of(path: Path) -> str:
    """Return the SHA-256 of the first certificate in a PEM file, as browsers show it.

    Raises:
        ConfigurationError: there is none.
    """
    try:
        text = path.read_text(encoding="ascii")
        begin = text.index(ssl.PEM_HEADER)
        end = text.index(ssl.PEM_FOOTER, begin) + len(ssl.PEM_FOOTER)
        digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(text[begin:end])).hexdigest().upper()
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"TLS: {path}: no certificate: {reason_of(error, path)}"
        ) from error
    return ":".join(digest[at : at + 2] for at in range(0, len(digest), 2))


def _found(path: Path) -> CertificateFacts | None:
    """Return what the certificate that is there says, None where there is none to be read."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None
    if stat.S_IMODE(mode) & 0o077:
        raise ConfigurationError(
            f"{path}: others may read this key: remove it, and a new one is made"
        )
    facts: CertificateFacts | None = _maker().read(path.read_bytes())
    return facts


def _maker() -> ModuleType:
    try:
        from uoarm._support import certificates  # noqa: PLC0415 - slow to import
    except ImportError as error:
        command = install_command("uoarm", "server")
        text = f"making a certificate needs the package {error.name!r}: {command}"
        raise ConfigurationError(text) from error
    return certificates
