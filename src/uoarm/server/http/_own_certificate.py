"""A certificate that the server makes for itself, for TLS without an authority."""

from __future__ import annotations

import hashlib
import os
import socket
import ssl
import stat
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path
from types import ModuleType

from uoarm._origin import install_command
from uoarm._whole_file import write_whole
from uoarm.errors import ConfigurationError

__all__ = ["fingerprint_of", "own_certificate", "state_folder"]

_VALID = timedelta(days=397)
_RENEW_BEFORE = timedelta(days=30)
_EARLIER = timedelta(hours=1)
_ALWAYS = ("localhost", "127.0.0.1", "::1")


def state_folder() -> Path:
    """Return where this user's programs keep what they must find again."""
    state = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return Path(state).expanduser() / "uoarm"


def own_certificate(folder: Path, names: Sequence[str], now: datetime | None = None) -> Path:
    """Return a PEM file with a key and a self-signed certificate, made when there is none to use.

    It is kept for over a year, so that clients may pin it, and made anew when it soon ends or does
    not name the server.

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
        if not _is_usable(path, wanted, moment):
            made = _maker().make(wanted, moment - _EARLIER, moment + _VALID)
            write_whole(path, made, private=True)
    except OSError as error:
        raise ConfigurationError(f"the server's own certificate: {path}: {error}") from error
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
        raise ConfigurationError(f"TLS: {path}: no certificate: {error}") from error
    return ":".join(digest[at : at + 2] for at in range(0, len(digest), 2))


def _is_usable(path: Path, wanted: Sequence[str], now: datetime) -> bool:
    """Say whether the file that is there can be used."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return False
    if stat.S_IMODE(mode) & 0o077:
        raise ConfigurationError(
            f"{path}: others may read this key: remove it, and a new one is made"
        )
    found = _maker().read(path.read_bytes())
    return found is not None and set(wanted) <= found.names and found.ends - now > _RENEW_BEFORE


def _maker() -> ModuleType:
    try:
        from uoarm._certificates import _authority  # noqa: PLC0415 - its package is slow to import
    except ImportError as error:
        command = install_command("uoarm", "server")
        text = f"making a certificate needs the package {error.name!r}: {command}"
        raise ConfigurationError(text) from error
    return _authority
