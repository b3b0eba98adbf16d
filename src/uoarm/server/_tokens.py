"""The access file: roles, and hashed tokens and certificate names that have them."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import yaml
from attrs import field, frozen

from uoarm.errors import ConfigurationError
from uoarm.server._role import Operation, Role

__all__ = ["AccessBook", "Grant", "Now", "hash_token", "make_token", "read_access"]

Now = Callable[[], datetime]

_TOKEN_BYTES = 32
_MAX_FILE = 1_048_576


@frozen
class Grant:
    """One token or certificate and the role it has.

    Attributes:
        name: for the audit log.
        role: what it may do.
        expires: when it ends; None: never.
    """

    name: str
    role: Role
    expires: datetime | None = None


@frozen
class AccessBook:
    """What an access file says.

    Attributes:
        tokens: grants by the SHA-256 of the token, in lower-case hex.
        certificates: grants by the common name of a client's certificate.
    """

    tokens: Mapping[str, Grant] = field(hash=False)
    certificates: Mapping[str, Grant] = field(factory=dict, hash=False)

    def grant_of(self, digest: str, now: datetime) -> Grant | None:
        """Return the grant of a token's hash, None for an unknown or expired one.

        Takes the same time whichever token it is: every hash is compared, each in constant time.
        """
        found: Grant | None = None
        for known, grant in self.tokens.items():
            if hmac.compare_digest(known, digest):
                found = grant
        return _unless_expired(found, now)

    def certificate_grant(self, name: str, now: datetime) -> Grant | None:
        """Return the grant of a certificate's common name."""
        return _unless_expired(self.certificates.get(name), now)


def make_token() -> str:
    """Return a new token of 256 random bits: too many to guess, so a plain hash keeps it safe."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def hash_token(token: str) -> str:
    """Return a token as it is kept at rest."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def read_access(path: Path) -> AccessBook:
    """Read an access file.

    Raises:
        ConfigurationError: it cannot be read or has mistakes; the text lists all of them.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_FILE + 1)
        data = yaml.safe_load(text) if len(text) <= _MAX_FILE else None
    except (OSError, yaml.YAMLError, UnicodeError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {error}") from error
    problems: list[str] = []
    book = _book(data, problems)
    if problems:
        raise ConfigurationError("\n".join(f"{path}: {problem}" for problem in problems))
    return book


def _book(data: Any, problems: list[str]) -> AccessBook:
    parts = _mapping(data, "the file", problems)
    _check_names(parts, "", ("version", "roles", "tokens", "certificates"), problems)
    if parts.get("version") != 1:
        problems.append(f"version: expected 1, got {parts.get('version')!r}")
    roles = {
        str(name): _role(str(name), rules, problems)
        for name, rules in _mapping(parts.get("roles", {}), "roles", problems).items()
    }
    tokens: dict[str, Grant] = {}
    listed = parts.get("tokens", [])
    if not isinstance(listed, list):
        problems.append("tokens: expected a list")
        listed = []
    for place, one in enumerate(listed):
        where = f"tokens[{place}]"
        entry = _mapping(one, where, problems)
        grant = _grant(str(entry.get("name", "")), entry, where, roles, problems)
        digest = entry.get("sha256")
        if not (isinstance(digest, str) and len(digest) == 64 and _is_hex(digest)):  # noqa: PLR2004 - hex digits of SHA-256
            problems.append(f"{where}.sha256: expected 64 hexadecimal digits")
        elif digest in tokens:
            problems.append(f"{where}.sha256: the same token stands above")
        else:
            tokens[digest] = grant
    certificates = {
        str(name): _grant(
            str(name), _mapping(entry, f"certificates.{name}", problems),
            f"certificates.{name}", roles, problems,
        )
        for name, entry in _mapping(
            parts.get("certificates", {}), "certificates", problems
        ).items()
    }  # fmt: skip
    return AccessBook(tokens, certificates)


def _role(name: str, data: Any, problems: list[str]) -> Role:
    rules: dict[Operation, tuple[str, ...]] = {}
    for key, patterns in _mapping(data, f"roles.{name}", problems).items():
        known = [operation.value for operation in Operation]
        if key not in known:
            problems.append(f"roles.{name}.{key}: expected one of {', '.join(known)}")
        elif not isinstance(patterns, list) or not all(isinstance(one, str) for one in patterns):
            problems.append(f"roles.{name}.{key}: expected a list of function patterns")
        else:
            rules[Operation(key)] = tuple(patterns)
    return Role(name, rules)


def _grant(
    name: str,
    entry: Mapping[str, Any],
    where: str,
    roles: Mapping[str, Role],
    problems: list[str],
) -> Grant:
    _check_names(entry, f"{where}.", ("name", "role", "sha256", "expires"), problems)
    role = roles.get(str(entry.get("role")))
    if role is None:
        problems.append(
            f"{where}.role: expected one of {', '.join(roles) or 'the roles'}, "
            f"got {entry.get('role')!r}"
        )
    expires = entry.get("expires")
    if expires is not None and not isinstance(expires, datetime):
        problems.append(f"{where}.expires: expected a time such as 2027-01-31T00:00:00Z")
        expires = None
    if isinstance(expires, datetime) and expires.tzinfo is None:
        expires = expires.replace(tzinfo=timezone.utc)
    return Grant(name or where, role or Role("", {}), expires)


def _unless_expired(grant: Grant | None, now: datetime) -> Grant | None:
    if grant is None or (grant.expires is not None and now >= grant.expires):
        return None
    return grant


def _is_hex(text: str) -> bool:
    return all(one in "0123456789abcdef" for one in text)


def _check_names(
    parts: Mapping[str, Any], where: str, known: tuple[str, ...], problems: list[str]
) -> None:
    expected = ", ".join(known)
    problems.extend(
        f"{where}{name}: unknown; expected {expected}" for name in parts if name not in known
    )


def _mapping(data: Any, where: str, problems: list[str]) -> Mapping[str, Any]:
    if isinstance(data, dict):
        return data
    problems.append(f"{where}: expected names and values, got {type(data).__name__}")
    return {}
