"""ECMA-262 regular expressions (u flag) turned into Python's, for the reference validator."""

from __future__ import annotations

import re
from functools import lru_cache

SPACE = r"\t\n\x0b\x0c\r \xa0\u1680\u2000-\u200a\u2028\u2029\u202f\u205f\u3000\ufeff"
_CLASSES = {
    "d": "0-9",
    "w": "A-Za-z0-9_",
    "s": SPACE,
}
_LINE_ENDS = r"\n\r\u2028\u2029"
_ESCAPES = {"f": "\f", "n": "\n", "r": "\r", "t": "\t", "v": "\v", "0": "\0"}
_TOKEN = re.compile(
    r"\\u\{(?P<braced>[0-9A-Fa-f]+)\}|\\u(?P<unit>[0-9A-Fa-f]{4})|\\x(?P<byte>[0-9A-Fa-f]{2})"
    r"|\\c(?P<control>[A-Za-z])|\\(?P<property>[pP]\{[^}]*\})|\\k<(?P<back>\w+)>"
    r"|\(\?<(?P<name>\w+)>|\\(?P<escaped>.)|(?P<plain>.)",
    re.DOTALL,
)


class UnsupportedPatternError(ValueError):
    """A pattern whose meaning this small translator does not know."""


@lru_cache(maxsize=4096)
def compiled(pattern: str) -> re.Pattern[str]:
    """``pattern`` with ECMA-262 meaning, to be used with ``search``."""
    try:
        return re.compile(_translate(pattern))
    except (re.error, OverflowError) as error:
        raise UnsupportedPatternError(f"{pattern!r}: {error}") from error


def _translate(pattern: str) -> str:
    out: list[str] = []
    in_class = False
    for token in _TOKEN.finditer(pattern):
        kind = token.lastgroup or ""
        text = token[kind]
        if kind in {"property", "back"}:
            raise UnsupportedPatternError(f"{pattern!r}: {token[0]}")
        if kind == "name":
            out.append(f"(?P<{text}>")
        elif kind in {"braced", "unit", "byte"}:
            out.append(_literal(chr(int(text, 16))))
        elif kind == "control":
            out.append(_literal(chr(ord(text) % 32)))
        elif kind == "escaped":
            out.append(_escaped(text, in_class=in_class))
        else:
            if text == "[" and not in_class:
                in_class = True
                out.append("[")
                continue
            if text == "]" and in_class:
                in_class = False
            out.append(_plain(text, in_class=in_class))
    return "".join(out).replace("[^]", r"[\s\S]").replace("[]", "(?!)")


def _escaped(text: str, *, in_class: bool) -> str:
    if text in _CLASSES:
        return _CLASSES[text] if in_class else f"[{_CLASSES[text]}]"
    if text.lower() in _CLASSES:
        if in_class:
            raise UnsupportedPatternError(f"\\{text} within a class")
        return f"[^{_CLASSES[text.lower()]}]"
    if text in _ESCAPES:
        return _literal(_ESCAPES[text])
    if text in {"b", "B"}:
        if in_class:
            return r"\x08"
        word = _CLASSES["w"]
        edge = f"(?:(?<=[{word}])(?![{word}])|(?<![{word}])(?=[{word}]))"
        return edge if text == "b" else f"(?!{edge})"
    if text in "123456789" and not in_class:
        return f"(?:\\{text})"
    if text.isalnum():
        raise UnsupportedPatternError(f"\\{text}")
    return _literal(text)


def _plain(text: str, *, in_class: bool) -> str:
    if in_class:
        return "\\[" if text == "[" else text.replace("&", "\\&").replace("~", "\\~")
    if text == ".":
        return f"[^{_LINE_ENDS}]"
    return {"$": r"\Z", "^": r"\A"}.get(text, text)


def _literal(text: str) -> str:
    return re.escape(text)
