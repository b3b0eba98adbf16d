"""Catalogues to XML and back."""

from __future__ import annotations

import stat
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from uoarm.errors import ConfigurationError
from uoarm_rocos._catalogue import PROFILE, Api, Catalogue, Kind
from uoarm_rocos._errors import WireError
from uoarm_rocos._field_xml import allowed, read_fields, write_fields
from uoarm_rocos._fields import NAME
from uoarm_rocos._limits import Limits
from uoarm_rocos._parse import parse
from uoarm_rocos._values import attribute, read_real, real, text

__all__ = ["load_catalogue", "read_catalogue", "write_catalogue"]

_HEARTBEATS = (0.05, 60.0)
_PARTS = ("text", "input", "output")
_MOST_OCTETS = 16_777_216


def load_catalogue(path: str | Path) -> Catalogue:
    """Read a catalogue from a file; blocks as long as the disk does.

    Raises:
        ConfigurationError: it cannot be read, or is no catalogue; the text says where.
    """
    try:
        data = _octets(Path(path))
        return read_catalogue(parse(data, Limits(octets=_MOST_OCTETS)))
    except (OSError, WireError) as error:
        raise ConfigurationError(f"catalogue {str(path)!r}: {error}") from error


def _octets(path: Path) -> bytes:
    """Read a regular file: a device or pipe could go on for ever. One too many tells the parser."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError("it is not a regular file")
    with path.open("rb") as file:
        return file.read(_MOST_OCTETS + 1)


def write_catalogue(catalogue: Catalogue, envelope: str = "") -> str:
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


def read_catalogue(root: ET.Element) -> Catalogue:
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
    return Catalogue(device, apis, root.get("revision", ""), _heartbeat(root))


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
    kinds = {kind.value: kind for kind in Kind}
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
    if kind is Kind.FLOW and not (parts.get("input") or parts.get("output")):
        raise WireError(f"API {name!r} is a flow with neither input nor output")
    return Api(name=name, kind=kind, period=_period(element, name, kind), **parts)


def _period(element: ET.Element, name: str, kind: Kind) -> float | None:
    written = element.get("period")
    if written is None:
        return None
    period = read_real(written)
    if kind is not Kind.FLOW or not 0 < period < float("inf"):
        raise WireError(f"API {name!r}: a period is seconds above 0, of a flow; got {written!r}")
    return period
