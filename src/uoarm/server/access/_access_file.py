"""Reading an access file: every mistake at once with its place, or who may do what."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path as File
from typing import Any

from uoarm._support.yaml import (
    Document,
    Path,
    Problem,
    ReadBudget,
    clip,
    mistakes_error,
    read_file,
    write_path,
)
from uoarm.server.access._role import OF_NO_FUNCTION, AccessPolicy, AccessRole, Grant, Operation

BUDGET = ReadBudget(octets=1_048_576, nodes=100_000, depth=16)
_ALL = "all"
_SUPERVISED = "supervised"
_NOT_SUPERVISED = (
    Operation.APPROVE,
    Operation.CONFIGURE,
    Operation.KEEP,
    Operation.RELEASE,
    Operation.RECORD,
)
_HASH = re.compile(r"[0-9a-f]{64}")
_TIME = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:\.(\d{1,6}))?(Z|[+-]\d\d:\d\d)?", re.ASCII
)
_KINDS = {dict: "names and values", list: "a list", type(None): "nothing"}


def read_access(path: File) -> AccessPolicy:
    """Read an access file.

    Raises:
        ConfigurationError: it cannot be read or has mistakes; the text lists the first 50.
    """
    document = read_file(path, BUDGET)
    reader = _Reader(document, str(path))
    book = reader.book() if document.whole else AccessPolicy({})
    problems = sorted([*document.problems, *reader.problems], key=lambda item: item.place)
    if problems:
        raise mistakes_error(problems)
    return book


class _Reader:
    def __init__(self, document: Document, file: str) -> None:
        self.problems: list[Problem] = []
        self._document = document
        self._file = file

    def book(self) -> AccessPolicy:
        parts = self._mapping(self._document.value, ())
        self._check_names(parts, (), ("version", "roles", "tokens", "certificates"))
        version = parts.get("version")
        if version != 1 or isinstance(version, bool):
            self._say(("version",), f"expected 1, got {clip(version)}")
        roles = {
            name: self._role(name, rules)
            for name, rules in self._mapping(parts.get("roles", {}), ("roles",)).items()
        }
        listed = parts.get("tokens", [])
        if not isinstance(listed, list):
            self._say(("tokens",), f"expected a list, got {_kind(listed)}")
            listed = []
        tokens: dict[str, Grant] = {}
        for place, item in enumerate(listed):
            self._token(item, ("tokens", place), roles, tokens)
        certificates = self._mapping(parts.get("certificates", {}), ("certificates",))
        return AccessPolicy(
            tokens,
            {
                name: self._grant(
                    name,
                    certificate,
                    ("certificates", name),
                    roles,
                    ("role", "expires", "principal"),
                )
                for name, certificate in certificates.items()
            },
        )

    def _role(self, name: str, data: Any) -> AccessRole:
        known = tuple(operation.value for operation in Operation)
        rules: dict[Operation, tuple[str, ...]] = {}
        everything: set[Operation] = set()
        supervised = False
        for key, wanted in self._mapping(data, ("roles", name)).items():
            path = ("roles", name, key)
            if key == _SUPERVISED:
                supervised = wanted is True
                if not isinstance(wanted, bool):
                    self._say(path, f"expected true or false, {_got(wanted)}")
            elif key not in known:
                self._say(path, f"expected one of {', '.join((*known, _SUPERVISED))}")
            elif wanted == _ALL:
                everything.add(Operation(key))
            elif Operation(key) in OF_NO_FUNCTION:
                self._say(
                    path,
                    f"{key} is of no function, so no pattern gives it: expected the word {_ALL}, "
                    f"{_got(wanted)}",
                    f"write `{key}: {_ALL}`, or leave it out",
                )
            elif not isinstance(wanted, list) or not all(
                isinstance(pattern, str) for pattern in wanted
            ):
                self._say(
                    path,
                    f'expected a list of function patterns such as ["*"], or the word {_ALL}, '
                    f"{_got(wanted)}",
                )
            else:
                rules[Operation(key)] = tuple(wanted)
        for operation in _NOT_SUPERVISED if supervised else ():
            if operation in rules or operation in everything:
                self._say(
                    ("roles", name, operation.value),
                    f"a supervised role has no {operation.value}: with it, it could do without an "
                    "approval",
                )
        return AccessRole(name, rules, frozenset(everything), supervised)

    def _token(
        self, data: Any, path: Path, roles: Mapping[str, AccessRole], tokens: dict[str, Grant]
    ) -> None:
        entry = self._mapping(data, path)
        name = entry.get("name", f"tokens[{path[-1]}]")
        if not isinstance(name, str):
            self._say((*path, "name"), f"expected text, {_got(name)}", "write it in quotes")
        grant = self._grant(
            str(name), entry, path, roles, ("name", "role", "sha256", "expires", "principal")
        )
        digest = entry.get("sha256")
        if not isinstance(digest, str) or not _HASH.fullmatch(digest):
            self._say(
                (*path, "sha256"),
                f"expected 64 hexadecimal digits, {_got(digest)}",
                "`uoarm token NAME --role ROLE` writes the whole line",
            )
        elif digest in tokens:
            self._say((*path, "sha256"), "the same token stands above")
        else:
            tokens[digest] = grant

    def _grant(
        self,
        name: str,
        data: Any,
        path: Path,
        roles: Mapping[str, AccessRole],
        known: tuple[str, ...],
    ) -> Grant:
        entry = self._mapping(data, path)
        self._check_names(entry, path, known)
        wanted = entry.get("role")
        role = roles.get(wanted) if isinstance(wanted, str) else None
        if role is None:
            expected = (
                ", ".join(clip(text) for text in roles) or "the roles, of which there are none"
            )
            self._say((*path, "role"), f"expected one of {expected}, got {clip(wanted)}")
        expires = _time(entry["expires"]) if "expires" in entry else None
        if "expires" in entry and expires is None:
            self._say(
                (*path, "expires"),
                f"expected a time such as 2027-01-31T00:00:00Z, {_got(entry['expires'])}",
            )
        principal = entry.get("principal", name)
        if not isinstance(principal, str) or not principal:
            self._say((*path, "principal"), f"expected text, {_got(principal)}")
        return Grant(name, role or AccessRole("", {}), expires, str(principal))

    def _check_names(self, parts: Mapping[str, Any], path: Path, known: tuple[str, ...]) -> None:
        for name in parts:
            if name not in known:
                self._say((*path, name), f"unknown; expected one of {', '.join(known)}")

    def _mapping(self, data: Any, path: Path) -> Mapping[str, Any]:
        if isinstance(data, dict):
            return data
        self._say(path, f"expected names and values, got {_kind(data)}")
        return {}

    def _say(self, path: Path, sentence: str, hint: str = "") -> None:
        self.problems.append(
            Problem(
                place=self._document.key_place(path),
                path=write_path(path),
                sentence=sentence,
                hint=hint,
                file=self._file,
                error_code="UOA-106",
            )
        )


def _time(data: object) -> datetime | None:
    """Read a time of day of a date; without a zone it is one of UTC."""
    found = _TIME.fullmatch(data) if isinstance(data, str) else None
    if found is None:
        return None
    day, time, fraction, zone = found.groups()
    offset = "+00:00" if zone in {None, "Z"} else zone
    try:
        return datetime.fromisoformat(f"{day}T{time}.{(fraction or '0'):0<6}{offset}")
    except ValueError:
        return None


def _kind(data: object) -> str:
    return _KINDS.get(type(data), clip(data))


def _got(data: object) -> str:
    return f"got {_kind(data)}"
