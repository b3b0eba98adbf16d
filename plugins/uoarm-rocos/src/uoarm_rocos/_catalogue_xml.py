"""Catalogues to XML and back."""

from __future__ import annotations

import stat
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

from uoarm.bridge import reason_of
from uoarm.errors import ConfigurationError
from uoarm_rocos._catalogue import (
    INT64,
    NAME,
    PROFILE,
    Api,
    ApiKind,
    BooleanField,
    DeviceCatalogue,
    Field,
    Fields,
    IntegerField,
    ListField,
    NamedField,
    NumberField,
    OctetsField,
    StringField,
    StructField,
)
from uoarm_rocos._framing import MessageLimits, WireError, parse
from uoarm_rocos._values import attribute, read_real, read_whole, real, text

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


def read_fields(parent: ET.Element, where: str) -> dict[str, NamedField]:
    """Read the fields inside an element; `where` is for errors.

    Raises:
        WireError: something is missing, unknown or contradictory.
    """
    fields: dict[str, NamedField] = {}
    for element in parent:
        name = element.get("name", "")
        if not NAME.fullmatch(name):
            raise WireError(f"{where}: {name[:40]!r} is no name of the profile")
        if name in fields:
            raise WireError(f"{where}: the field {name!r} is given twice")
        required = _truth(element, "required", f"{where}.{name}", default=True)
        fields[name] = NamedField(_read(element, f"{where}.{name}", {"name", "required"}), required)
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
    "boolean": lambda _element, _where: (BooleanField(), set()),
    "integer": _integer,
    "number": _number,
    "string": _string,
    "octets": lambda element, where: (
        OctetsField(_size(element, "maxLength", where)),
        {"maxLength"},
    ),
    "struct": lambda element, where: (StructField(read_fields(element, where)), set()),
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


_HEARTBEATS = (0.05, 60.0)
_PARTS = ("text", "input", "output")
_MOST_OCTETS = 16_777_216


def load_catalogue(path: str | Path) -> DeviceCatalogue:
    """Read a catalogue from a file; blocks as long as the disk does.

    Raises:
        ConfigurationError: it cannot be read, or is no catalogue; the text says where.
    """
    try:
        data = _octets(Path(path))
        return read_catalogue(parse(data, MessageLimits(octets=_MOST_OCTETS)))
    except (OSError, WireError) as error:
        raise ConfigurationError(f"catalogue {str(path)!r}: {reason_of(error, path)}") from error


def _octets(path: Path) -> bytes:
    """Read a regular file: a device or pipe could go on for ever.

    One octet more than the limit makes the parser refuse it.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError("it is not a regular file")
    with path.open("rb") as file:
        return file.read(_MOST_OCTETS + 1)


def write_catalogue(catalogue: DeviceCatalogue, envelope: str = "") -> str:
    """Write a catalogue; `envelope` is further attributes, each after a space.

    Raises:
        WireError: a name or text is none of the profile.
    """
    revision = f' revision="{attribute(catalogue.revision)}"' if catalogue.revision else ""
    apis = "".join(_write_api(api) for api in catalogue.apis.values())
    return (
        f'<catalogue profile="{PROFILE}" device="{attribute(catalogue.device)}"{revision} '
        f'heartbeat="{real(catalogue.heartbeat)}"{envelope}>{apis}</catalogue>'
    )


def read_catalogue(root: ET.Element) -> DeviceCatalogue:
    """Read a catalogue from its element.

    Raises:
        WireError: something is missing, unknown or contradictory; the text says where.
    """
    if root.tag != "catalogue":
        raise WireError(f"expected <catalogue>, got <{root.tag[:40]}>")
    allowed(root, {"profile", "device", "revision", "heartbeat", "id", "seq"}, "catalogue")
    profile = root.get("profile")
    if profile != str(PROFILE):
        raise WireError(f"the catalogue is of profile {profile}, this is a host of {PROFILE}")
    device = root.get("device")
    if device is None:
        raise WireError("the catalogue does not name its device")
    apis: dict[str, Api] = {}
    for element in root:
        if element.tag != "api":
            raise WireError(f"expected <api> in the catalogue, got <{element.tag[:40]}>")
        api = _read_api(element)
        if api.name in apis:
            raise WireError(f"API {api.name!r} is in the catalogue twice")
        apis[api.name] = api
    return DeviceCatalogue(device, apis, root.get("revision", ""), _heartbeat(root))


def _heartbeat(root: ET.Element) -> float:
    heartbeat = read_real(root.get("heartbeat", "1.0"))
    if not _HEARTBEATS[0] <= heartbeat <= _HEARTBEATS[1]:
        raise WireError(f"the heartbeat must be 0.05 to 60 seconds, the catalogue says {heartbeat}")
    return heartbeat


def _write_api(api: Api) -> str:
    if not NAME.fullmatch(api.name):
        raise WireError(f"{api.name[:40]!r} is no name of the profile")
    period = "" if api.period is None else f' period="{real(api.period)}"'
    message = f"<text>{text(api.text)}</text>" if api.text else ""
    sides = "".join(
        f"<{side}>{write_fields(fields)}</{side}>"
        for side, fields in (("input", api.input), ("output", api.output))
        if fields
    )
    return f'<api name="{api.name}" kind="{api.kind.value}"{period}>{message}{sides}</api>'


def _read_api(element: ET.Element) -> Api:
    allowed(element, {"name", "kind", "period"}, "api")
    name = element.get("name", "")
    if not NAME.fullmatch(name):
        raise WireError(f"<api>: {name[:40]!r} is no name of the profile")
    kinds = {kind.value: kind for kind in ApiKind}
    kind = kinds.get(element.get("kind", ""))
    if kind is None:
        raise WireError(f"API {name!r}: kind must be service or flow, got {element.get('kind')!r}")
    parts: dict[str, Any] = {}
    for part in element:
        if part.tag not in _PARTS or part.tag in parts or part.attrib:
            raise WireError(f"API {name!r}: unexpected or second <{part.tag[:40]}>")
        where = f"API {name!r}, {part.tag}"
        parts[part.tag] = (part.text or "") if part.tag == "text" else read_fields(part, where)
    if list(parts) != [part for part in _PARTS if part in parts]:
        raise WireError(f"API {name!r}: expected text, input, output in this order")
    if kind is ApiKind.FLOW and not (parts.get("input") or parts.get("output")):
        raise WireError(f"API {name!r} is a flow with neither input nor output")
    return Api(name=name, kind=kind, period=_period(element, name, kind), **parts)


def _period(element: ET.Element, name: str, kind: ApiKind) -> float | None:
    written = element.get("period")
    if written is None:
        return None
    period = read_real(written)
    if kind is not ApiKind.FLOW or not 0 < period < float("inf"):
        raise WireError(f"API {name!r}: a period is seconds above 0, of a flow; got {written!r}")
    return period
