"""XML text to an element tree, refusing what is dangerous or beyond the limits."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

from attrs import frozen
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser

from uoarm_rocos._errors import WireError

__all__ = ["SERIAL_LIMITS", "TCP_LIMITS", "MessageLimits", "parse"]


@frozen
class MessageLimits:
    """Bounds of one message, as section 7 of the profile has them.

    Attributes:
        octets: most octets of a message before framing.
        depth: most elements inside each other.
        elements: most elements in a message.
        attribute_octets: most octets of one attribute.
        attributes: most attributes of one element.
    """

    octets: int = 1_048_576
    depth: int = 32
    elements: int = 100_000
    attribute_octets: int = 1024
    attributes: int = 16


TCP_LIMITS = MessageLimits()
SERIAL_LIMITS = MessageLimits(octets=65_536)


def parse(data: bytes, limits: MessageLimits) -> ET.Element:
    """Parse one message.

    Raises:
        WireError: it is no XML, not UTF-8, has a DTD, or is beyond the limits.
    """
    if len(data) > limits.octets:
        raise WireError(f"a message has {len(data):,} octets, {limits.octets:,} are allowed")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise WireError(f"a message is not UTF-8: octet {error.start} of {len(data)}") from error
    if text.startswith("<?xml"):
        _check_declaration(text)
    parser = DefusedXMLParser(target=_Builder(limits), forbid_dtd=True)
    try:
        parser.feed(text)
        root = parser.close()
    except DefusedXmlException as error:
        raise WireError(f"a message holds a document type declaration: {error}") from error
    except (ET.ParseError, ValueError) as error:
        raise WireError(f"a message is no XML: {error}") from error
    assert isinstance(root, ET.Element)
    return root


def _check_declaration(text: str) -> None:
    declaration = text.partition("?>")[0].lower()
    if "encoding" in declaration and "utf-8" not in declaration:
        raise WireError(f"a message declares another encoding than UTF-8: {declaration[:60]!r}")


class _Builder(ET.TreeBuilder):
    """Counts while the tree grows, so that nothing beyond the limits is ever built."""

    def __init__(self, limits: MessageLimits) -> None:
        super().__init__()
        self._limits = limits
        self._depth = 0
        self._elements = 0

    def start(self, tag: Any, attributes: Any, /) -> ET.Element:
        limits = self._limits
        self._depth += 1
        self._elements += 1
        if self._depth > limits.depth:
            raise WireError(f"elements stand more than {limits.depth} deep inside each other")
        if self._elements > limits.elements:
            raise WireError(f"a message has more than {limits.elements:,} elements")
        if len(attributes) > limits.attributes:
            raise WireError(f"an element has more than {limits.attributes} attributes")
        for name, value in attributes.items():
            if max(len(name), len(value)) * 4 > limits.attribute_octets and (
                max(len(name.encode()), len(value.encode())) > limits.attribute_octets
            ):
                raise WireError(
                    f"attribute {name[:20]!r} has over {limits.attribute_octets} octets"
                )
        return super().start(tag, attributes)

    def end(self, tag: str, /) -> ET.Element:
        self._depth -= 1
        return super().end(tag)

    def pi(self, target: str, text: str | None = None, /) -> Any:
        del text
        raise WireError(f"a message holds a processing instruction <?{target[:20]}")
