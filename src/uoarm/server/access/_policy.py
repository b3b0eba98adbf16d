"""Hashed tokens and certificate names, and the roles that they have."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Callable, Mapping
from datetime import datetime

from attrs import field, frozen

from uoarm.server.access._role import Role

__all__ = ["AccessPolicy", "Grant", "Now", "hash_token", "make_token"]

Now = Callable[[], datetime]

_TOKEN_BYTES = 32


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
class AccessPolicy:
    """Which credentials have which role, as an access file says.

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


def _unless_expired(grant: Grant | None, now: datetime) -> Grant | None:
    if grant is None or (grant.expires is not None and now >= grant.expires):
        return None
    return grant
