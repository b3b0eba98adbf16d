"""Fields of a catalogue to XML and back."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable

from uoarm_rocos._errors import WireError
from uoarm_rocos._fields import (
    INT64,
    NAME,
    BooleanField,
    Field,
    Fields,
    IntegerField,
    ListField,
    Member,
    NumberField,
    OctetsField,
    StringField,
    StructField,
)
from uoarm_rocos._values import attribute, read_real, read_whole, real, text

__all__ = ["allowed", "read_fields", "write_fields"]

_TAGS: dict[type, str] = {
    BooleanField: "boolean",
    IntegerField: "integer",
    NumberField: "number",
    StringField: "string",
    OctetsField: "octets",
    StructField: "struct",
    ListField: "list",
}


def allowed(element: ET.Element, names: set[str], where: str) -> None:
    """Refuse attributes that the profile does not have at this place.

    Raises:
        WireError: naming the attribute.
    """
    for name in element.attrib:
        if name not in names:
            raise WireError(f"{where}: unknown attribute {name[:40]!r} of <{element.tag[:40]}>")


def write_fields(fields: Fields) -> str:
    """Write the fields of one side of an API, or of a struct.

    Raises:
        WireError: a name or text is none of the profile.
    """
    written = []
    for name, member in fields.items():
        if not NAME.fullmatch(name):
            raise WireError(f"{name[:40]!r} is no name of the profile")
        required = "" if member.required else ' required="false"'
        written.append(_write(member.type, f' name="{name}"{required}'))
    return "".join(written)


def read_fields(parent: ET.Element, where: str) -> dict[str, Member]:
    """Read the fields inside an element; `where` is for errors.

    Raises:
        WireError: something is missing, unknown or contradictory.
    """
    fields: dict[str, Member] = {}
    for element in parent:
        name = element.get("name", "")
        if not NAME.fullmatch(name):
            raise WireError(f"{where}: {name[:40]!r} is no name of the profile")
        if name in fields:
            raise WireError(f"{where}: the field {name!r} is given twice")
        required = _truth(element, "required", f"{where}.{name}", default=True)
        fields[name] = Member(_read(element, f"{where}.{name}", {"name", "required"}), required)
    return fields


def _write(kind: Field, named: str) -> str:
    tag = _TAGS[type(kind)]
    inner, extra = "", {}
    if isinstance(kind, IntegerField):
        low, high = INT64
        extra["unit"] = attribute(kind.unit)
        extra["minimum"] = "" if kind.minimum == low else str(kind.minimum)
        extra["maximum"] = "" if kind.maximum == high else str(kind.maximum)
    elif isinstance(kind, NumberField):
        extra["unit"] = attribute(kind.unit)
        extra["minimum"] = "" if kind.minimum is None else real(kind.minimum)
        extra["maximum"] = "" if kind.maximum is None else real(kind.maximum)
        extra["nonfinite"] = "true" if kind.nonfinite else ""
    elif isinstance(kind, StringField):
        extra["maxLength"] = "" if kind.max_length is None else str(kind.max_length)
        inner = "".join(f"<choice>{text(choice)}</choice>" for choice in kind.choices)
    elif isinstance(kind, OctetsField):
        extra["maxLength"] = "" if kind.max_length is None else str(kind.max_length)
    elif isinstance(kind, ListField):
        extra["minItems"] = str(kind.min_items) if kind.min_items else ""
        extra["maxItems"] = "" if kind.max_items is None else str(kind.max_items)
        inner = _write(kind.items, "")
    elif isinstance(kind, StructField):
        inner = write_fields(kind.members)
    attributes = "".join(f' {key}="{value}"' for key, value in extra.items() if value)
    return f"<{tag}{named}{attributes}>{inner}</{tag}>"


def _read(element: ET.Element, where: str, known: set[str]) -> Field:
    read = _READERS.get(element.tag)
    if read is None:
        raise WireError(f"{where}: <{element.tag[:40]}> is no type of the profile")
    kind, names = read(element, where)
    allowed(element, known | names, where)
    if len(element) and element.tag not in {"string", "struct", "list"}:
        raise WireError(f"{where}: <{element.tag}> holds no elements")
    return kind


def _boolean(element: ET.Element, where: str) -> tuple[Field, set[str]]:
    del element, where
    return BooleanField(), set()


def _integer(element: ET.Element, where: str) -> tuple[Field, set[str]]:
    low, high = INT64
    minimum = read_whole(element.get("minimum", str(low)))
    maximum = read_whole(element.get("maximum", str(high)))
    if minimum > maximum:
        raise WireError(f"{where}: minimum {minimum} is above maximum {maximum}")
    kind = IntegerField(minimum, maximum, element.get("unit", ""))
    return kind, {"minimum", "maximum", "unit"}


def _number(element: ET.Element, where: str) -> tuple[Field, set[str]]:
    bounds = [
        None if written is None else read_real(written)
        for written in (element.get("minimum"), element.get("maximum"))
    ]
    minimum, maximum = bounds
    for bound in bounds:
        if bound is not None and (bound != bound or bound in {float("inf"), -float("inf")}):  # noqa: PLR0124 - NaN
            raise WireError(f"{where}: a bound must be finite, got {bound}")
    if minimum is not None and maximum is not None and minimum > maximum:
        raise WireError(f"{where}: minimum {minimum} is above maximum {maximum}")
    nonfinite = _truth(element, "nonfinite", where, default=False)
    kind = NumberField(minimum, maximum, element.get("unit", ""), nonfinite)
    return kind, {"minimum", "maximum", "unit", "nonfinite"}


def _string(element: ET.Element, where: str) -> tuple[Field, set[str]]:
    for choice in element:
        if choice.tag != "choice" or choice.attrib or len(choice):
            raise WireError(f"{where}: a string holds <choice> only, got <{choice.tag[:40]}>")
    choices = tuple(choice.text or "" for choice in element)
    return StringField(choices, _size(element, "maxLength", where)), {"maxLength"}


def _octets(element: ET.Element, where: str) -> tuple[Field, set[str]]:
    return OctetsField(_size(element, "maxLength", where)), {"maxLength"}


def _struct(element: ET.Element, where: str) -> tuple[Field, set[str]]:
    return StructField(read_fields(element, where)), set()


def _list(element: ET.Element, where: str) -> tuple[Field, set[str]]:
    if len(element) != 1:
        raise WireError(
            f"{where}: a list holds the one field that its items are, got {len(element)}"
        )
    low, high = _size(element, "minItems", where) or 0, _size(element, "maxItems", where)
    if high is not None and low > high:
        raise WireError(f"{where}: minItems {low} is above maxItems {high}")
    return ListField(_read(element[0], f"{where}[]", set()), low, high), {"minItems", "maxItems"}


_READERS: dict[str, Callable[[ET.Element, str], tuple[Field, set[str]]]] = {
    "boolean": _boolean,
    "integer": _integer,
    "number": _number,
    "string": _string,
    "octets": _octets,
    "struct": _struct,
    "list": _list,
}


def _truth(element: ET.Element, name: str, where: str, *, default: bool) -> bool:
    written = element.get(name)
    if written is None:
        return default
    if written not in {"true", "false"}:
        raise WireError(f"{where}: {name} must be true or false, got {written[:40]!r}")
    return written == "true"


def _size(element: ET.Element, name: str, where: str) -> int | None:
    written = element.get(name)
    if written is None:
        return None
    size = read_whole(written)
    if not 0 <= size < 2**32:
        raise WireError(f"{where}: {name} must be 0 to 4294967295, got {written}")
    return size
