"""What is secret by its name, and secrets within texts: hidden before anything is written down."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

HIDDEN = "***"
"""What stands in the place of a secret."""

_NAMES = (
    r"passw(?:or)?d|passphrase|passcode|secret|token|credential|api[_-]?key"
    r"|(?:private|access|signing|shared|encryption)[_-]?key"
)
_NAME = re.compile(rf"(?i:{_NAMES}|authorization|cookie)|(?i:(?:^|[_-])(?:pass|pwd|psk)(?:$|[_-]))")
# Where a secret is, how it is called and how long it lasts are none.
_ABOUT = re.compile(
    r"(?i)[_-](?:file|path|folder|id|name|type|url|seconds|lifetime|count|limit)s?$"
)
_IN_TEXT = (
    (re.compile(r"(?<=://)[^\s/@]+(?=@)"), HIDDEN),
    (re.compile(r"(?i)\b(bearer\s+)[^\s\"',;]+"), rf"\1{HIDDEN}"),
    (re.compile(rf"(?i)((?:{_NAMES})\s?=\s?)[^\s&;,\"']*[^\s&;,\"':]"), rf"\1{HIDDEN}"),
    # Bounded, as a line of hyphens would cost the square of its length.
    (re.compile(rf"(?i)(--[\w-]{{0,40}}(?:{_NAMES})\s+)[^\s\"']+"), rf"\1{HIDDEN}"),
)
_OPTION = re.compile(rf"(?i)--[\w-]*(?:{_NAMES})")


def is_secret_name(name: str) -> bool:
    """Say whether what has this name is a secret, not only about one, as `token_file` is."""
    return _NAME.search(name) is not None and _ABOUT.search(name) is None


def without_secrets(value: Any) -> Any:
    """Return plain data in which secrets are hidden.

    Those are members with such a name, users in URLs, and in a text what follows `Bearer`,
    `token=` or `--password`, also as two items of a list.
    """
    if isinstance(value, Mapping):
        return {
            str(name): HIDDEN
            if is_secret_name(str(name)) and item not in (None, "")
            else without_secrets(item)
            for name, item in value.items()
        }
    if isinstance(value, list | tuple):
        return list(_items(value))
    if isinstance(value, str):
        for pattern, instead in _IN_TEXT:
            value = pattern.sub(instead, value)
    return value


def _items(values: Iterable[Any]) -> Iterator[Any]:
    follows = False
    for value in values:
        yield HIDDEN if follows and isinstance(value, str) else without_secrets(value)
        follows = isinstance(value, str) and _OPTION.fullmatch(value) is not None
