"""Who may join from another machine, and what it may touch: mutual TLS and an access list.

Everything is denied but to a machine whose certificate carries its name, and to that one only the
keys that begin with it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from attrs import frozen

from uoarm._host.transport import keys
from uoarm.errors import BridgeError, FailureReason

__all__ = ["MANAGER", "Identity", "access_list", "certified"]

MANAGER = "manager"
"""The name of the manager's files in a folder of certificates."""

_AUTHORITY = "ca"
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_MOST_CERTIFIED = 1024
_OTHERS = 0o077
_MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


@frozen
class Identity:
    """The files by which one end of a link shows who it is and knows whom to believe."""

    authority: Path
    certificate: Path
    key: Path

    @classmethod
    def find(cls, folder: str | Path, name: str) -> Identity:
        """Return `ca.pem`, `NAME.pem` and `NAME.key` of a folder.

        Raises:
            BridgeError: one of them is missing, or others than its owner may read the key.
        """
        home = Path(folder).expanduser()
        found = cls(home / "ca.pem", home / f"{name}.pem", home / f"{name}.key")
        for file in (found.authority, found.certificate, found.key):
            if not file.is_file():
                text = f"there is no {file}; make it: uoarm certificates --help"
                raise BridgeError(text, FailureReason.NOT_FOUND)
        if os.name == "posix" and found.key.stat().st_mode & _OTHERS:
            text = f"others may read the private key {found.key}: chmod 600 it"
            raise BridgeError(text, FailureReason.REFUSED)
        return found

    def settings(self, *, listen: bool) -> dict[str, object]:
        """Return Zenoh's settings for the end that listens, or for one that joins."""
        side = "listen" if listen else "connect"
        return {
            "transport/link/tls": {
                "root_ca_certificate": str(self.authority),
                f"{side}_certificate": str(self.certificate),
                f"{side}_private_key": str(self.key),
                "enable_mtls": True,
                "verify_name_on_connect": True,
                "close_link_on_expiration": True,
            }
        }


def certified(folder: str | Path) -> frozenset[str]:
    """Return the machines whose certificates are in a folder, a thousand at most."""
    found = sorted(file.stem for file in Path(folder).expanduser().glob("*.pem"))
    # A name becomes part of a key, where `*` and `/` would open the keys of other machines.
    names = [name for name in found if name not in {_AUTHORITY, MANAGER} and _NAME.fullmatch(name)]
    return frozenset(names[:_MOST_CERTIFIED])


def access_list(machines: Iterable[str] | None) -> Mapping[str, object]:
    """Return Zenoh's settings under which each machine reaches its own keys, and no other.

    Args:
        machines: their names, as in their certificates; None where there are none, as on a
            loopback without TLS: a client that connects may touch the keys of every machine.
    """
    if machines is None:
        rules = [_rule("any-client", f"{keys.MACHINES}/**")]
        subjects: list[dict[str, object]] = [{"id": "any-client"}]
    else:
        names = sorted(machines)
        rules = [_rule(name, f"{keys.MACHINES}/{name}/**") for name in names]
        subjects = [{"id": name, "cert_common_names": [name]} for name in names]
    return {
        "access_control": {
            "enabled": True,
            # Both ways: a machine neither gets what is sent to another, nor sends in its name.
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": [
                {"rules": [subject["id"]], "subjects": [subject["id"]]} for subject in subjects
            ],
        }
    }


def _rule(name: str, key: str) -> dict[str, object]:
    return {
        "id": name,
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": list(_MESSAGES),
        "key_exprs": [key],
    }
