"""The text of `.msg`, `.srv` and `.action` files, read by the rules of ROS 2's `rosidl_adapter`.

Every value is read by the type of its field or constant and checked against it, and what
`rosidl_adapter` refuses is refused here, as no package with it could be built. Where its rules are
odd (a `#` ends a line within quotes, too) they are kept: a node has what they make of the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from attrs import frozen

from uoarm.cdr import BASIC
from uoarm_ros2._types import ScalarType, StringType, integer_range

_LOWER = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")
_UPPER = re.compile(r"[A-Z](?:_?[A-Z0-9])*")
_MESSAGE = re.compile(r"[A-Z][A-Za-z0-9]*")
_ENDINGS = ("_Request", "_Response", "_Goal", "_Result", "_Feedback")
_TEXTS = frozenset({"string", "wstring"})
_SCALARS = BASIC.keys() - _TEXTS
_OF_ROS1 = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}
_SEPARATOR = "---"
_QUOTES = ('"', "'")
_MARK = "\N{BYTE ORDER MARK}"


@frozen
class ParsedType:
    """The type of a field. `element` is the name of a type, where it is another message.

    `size` is the length of an array that is `fixed`, or the most elements of one that is not.
    """

    element: ScalarType | StringType | str
    many: bool = False
    size: int | None = None
    fixed: bool = False


@frozen
class ParsedField:
    """A field; `line` is where its file has it, 0 where that is not known."""

    name: str
    kind: ParsedType
    default: object = None
    line: int = 0


@frozen
class _Constant:
    name: str
    value: object


@frozen
class ParsedMessage:
    """One message: a whole `.msg` file or a part of another."""

    members: tuple[ParsedField, ...]
    constants: Mapping[str, object]


def parse_file(text: str, names: Sequence[str]) -> list[ParsedMessage]:
    """Return the messages of a file, one for each name that it has to define.

    Args:
        text: of the file.
        names: as `package/srv/Name_Request`; the package is that of types named without one.

    Raises:
        ValueError: ROS 2 would not build it; with the line.
    """
    package = names[0].partition("/")[0]
    if not _LOWER.fullmatch(package):
        raise ValueError(
            f"the folder {package!r:.100} is no name of a package: small letters, digits and "
            f"single _"
        )
    for name in names:
        _require_message_name(name.rpartition("/")[2])
    if text.startswith(_MARK):
        raise ValueError("line 1: a byte order mark comes first: save the file without one")
    parts: list[list[tuple[int, str]]] = [[]]
    for number, line in enumerate(text.splitlines(), 1):
        if line == _SEPARATOR and len(names) > 1:
            parts.append([])
        else:
            parts[-1].append((number, line))
    if len(parts) != len(names):
        lines = ", ".join(str(n) for p in parts for n, line in p if line.strip() == _SEPARATOR)
        hint = f"; nothing may stand beside --- (line {lines})" if lines else ""
        raise ValueError(
            f"{len(parts)} parts between lines of {_SEPARATOR}, not {len(names)}{hint}"
        )
    return [_parse(part, package) for part in parts]


def require_one_each(names: Sequence[str], what: str) -> None:
    """Raise ValueError where a name comes twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"two {what}s are called {', '.join(twice)}")


def _parse(lines: Sequence[tuple[int, str]], package: str) -> ParsedMessage:
    members: list[ParsedField] = []
    constants: dict[str, object] = {}
    places: dict[str, int] = {}
    for number, line in lines:
        content = line.replace("\t", " ").partition("#")[0].rstrip()
        if not content:
            continue
        place = f"line {number}: {content.strip()!r:.100}"
        kind, _, rest = content.partition(" ")
        if not rest:
            raise ValueError(f"{place} is no field, constant or comment")
        try:
            entry = _entry(kind, rest.lstrip(), package, number)
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from None
        if entry.name in places:
            raise ValueError(f"{place}: line {places[entry.name]} defines {entry.name} already")
        places[entry.name] = number
        if isinstance(entry, ParsedField):
            members.append(entry)
        else:
            constants[entry.name] = entry.value
    return ParsedMessage(tuple(members), constants)


def _entry(kind: str, rest: str, package: str, line: int) -> ParsedField | _Constant:
    if not kind:
        raise ValueError("a line must not begin with blanks")
    is_constant = "=" in rest
    name, _, value = rest.partition("=" if is_constant else " ")
    if is_constant:
        return _constant(kind, name.rstrip(), value.lstrip())
    return _member(kind, name, value.lstrip(), package, line)


def _constant(kind: str, name: str, value: str) -> _Constant:
    if kind not in _SCALARS | _TEXTS:
        raise ValueError(f"a constant is a number, a bool or a string, not {kind}")
    if not _UPPER.fullmatch(name):
        raise ValueError(
            f"{name!r} is no name of a constant: capital letters, digits and single _ "
            f"(a default stands after a blank, without = in it)"
        )
    return _Constant(name, _value(kind, value, None))


def _member(text: str, name: str, default: str, package: str, line: int) -> ParsedField:
    kind, plain = _kind(text, package)
    if not _LOWER.fullmatch(name):
        hint = f"; a constant is written {name}=..." if _UPPER.fullmatch(name) and default else ""
        raise ValueError(
            f"{name!r} is no name of a field: small letters, digits and single _, a letter "
            f"first{hint}"
        )
    if not default:
        return ParsedField(name, kind, None, line)
    if isinstance(kind.element, str):
        raise ValueError("a field that is a message has no default")  # noqa: TRY004 - of a file
    bound = kind.element.bound if isinstance(kind.element, StringType) else None
    if not kind.many:
        return ParsedField(name, kind, _value(plain, default, bound), line)
    if not (default.startswith("[") and default.endswith("]")):
        raise ValueError(f"expected the default of an array as [1, 2], got {default!r:.100}")
    inner = default[1:-1]
    texts = list(_elements(inner)) if plain in _TEXTS else inner.split(",") if inner else []
    if kind.size is not None and (
        len(texts) != kind.size if kind.fixed else len(texts) > kind.size
    ):
        wanted = "" if kind.fixed else "at most "
        raise ValueError(f"expected {wanted}{kind.size} elements, got {len(texts)}")
    return ParsedField(name, kind, [_value(plain, word.strip(), bound) for word in texts], line)


def _kind(text: str, package: str) -> tuple[ParsedType, str]:
    """Return the type of a field and how its elements are called in a file."""
    if not text.endswith("]"):
        element, plain = _element(text, package)
        return ParsedType(element), plain
    inner, bracket, length = text[:-1].rpartition("[")
    if not bracket:
        raise ValueError(f"{text} ends with ] and has no [")
    element, plain = _element(inner, package)
    if not length:
        return ParsedType(element, many=True), plain
    size = _positive(length.removeprefix("<="), f"the length of {text}")
    return ParsedType(element, many=True, size=size, fixed=not length.startswith("<=")), plain


def _element(text: str, package: str) -> tuple[ScalarType | StringType | str, str]:
    if text in _SCALARS:
        return ScalarType("uint8" if text == "char" else text), text
    plain, bounded, bound = text.partition("<=")
    if plain in _TEXTS:
        limit = _positive(bound, f"the bound of {text}") if bounded else None
        return StringType(wide=plain == "wstring", bound=limit), plain
    if text in _OF_ROS1:
        raise ValueError(f"ROS 2 has no type {text}, but {_OF_ROS1[text]}")
    parts = text.split("/")
    if len(parts) > 2:  # noqa: PLR2004 - package and name
        raise ValueError(f"{text} is no type: another message is named package/Name")
    owner = parts[0] if len(parts) > 1 else package
    if not _LOWER.fullmatch(owner):
        raise ValueError(f"{text} is no type: {owner!r} is no name of a package")
    _require_message_name(parts[-1])
    return f"{owner}/msg/{parts[-1]}", ""


def _require_message_name(name: str) -> None:
    plain = name.removeprefix("Sample_")
    for ending in _ENDINGS:
        plain = plain.removesuffix(ending)
    if not _MESSAGE.fullmatch(plain):
        raise ValueError(
            f"{name!r:.100} is neither a type of ROS 2 nor the name of a message: letters and "
            f"digits, a capital first"
        )


def _positive(text: str, what: str) -> int:
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number <= 0:
        raise ValueError(f"{what} must be a whole number above 0, got {text!r:.100}")
    return number


def _value(kind: str, text: str, bound: int | None) -> object:
    """Return a value by its type, as the parsers of Python behind `rosidl_adapter` read it."""
    if kind in _TEXTS:
        return _text(text, bound)
    if kind == "bool":
        if text.lower() not in {"true", "false", "1", "0"}:
            raise ValueError(f"expected true, false, 1 or 0, got {text!r:.100}")
        return text.lower() in {"true", "1"}
    if kind.startswith("float"):
        try:
            return float(text)
        except ValueError:
            raise ValueError(f"expected a number, got {text!r:.100}") from None
    return _integer("uint8" if kind in {"byte", "char"} else kind, text)


def _integer(kind: str, text: str) -> int:
    least, greatest = integer_range(kind) or (0, 0)
    for base in (10, 0):  # 010 is ten, 0x10 sixteen
        try:
            number = int(text, base)
        except ValueError:
            continue
        if least <= number <= greatest:
            return number
        break
    raise ValueError(f"expected a whole number from {least} to {greatest}, got {text!r:.100}")


def _text(text: str, bound: int | None) -> str:
    for quote in _QUOTES:
        if text.startswith(quote) and text.endswith(quote):
            text = text[1:-1]
            if re.search(rf"(?<!\\){quote}", text):
                raise ValueError(f"a {quote} within {quote} is written \\{quote}")
            text = text.replace(f"\\{quote}", quote)
            break
    if bound is not None and len(text) > bound:
        raise ValueError(f"expected at most {bound} characters, got {len(text)}")
    return text


def _elements(text: str) -> Iterator[str]:
    """Yield the texts of an array, which may be quoted and then hold commas."""
    while text:
        text = text.lstrip(" ")
        if not text or text[0] == ",":
            raise ValueError("an element of the array is missing")
        quoted = False
        for quote in _QUOTES:
            if text.startswith(quote):
                quoted = True
                end = _end_of_quoted(text, quote)
                yield text[1:end].replace(f"\\{quote}", quote)
                text = text[end + 1 :]
        if not quoted:
            element, comma, rest = text.partition(",")
            yield element
            text = comma + rest
        text = text.lstrip(" ").removeprefix(",")


def _end_of_quoted(text: str, quote: str) -> int:
    """Return where a quoted text ends; after a second escaped quote too early, as in ROS 2."""
    behind = 0
    while text:
        at = text[1:].find(quote)
        if at < 0:
            break
        if text[at : at + 2] != f"\\{quote}":
            return behind + at + 1
        text, behind = text[at + 2 :], at + 2
    raise ValueError(f"a text of the array has no {quote} at its end")
