"""From messages to CDR: one generated function per type and byte order, every value checked.

The generated text takes the common case at a glance and packs runs of scalars at once. Whatever
it cannot take goes to a checker; when that fails, `_explain` walks the message once more,
slowly, to name the field.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct

from uoarm.model import Message
from uoarm_rtm._arrays import blocks, counted, is_block
from uoarm_rtm._generate import GeneratedFunction
from uoarm_rtm._scalars import CODES, SIZES, Order, checker
from uoarm_rtm._schema import SWITCH
from uoarm_rtm._shape import IdlEnum, IdlScalar, IdlSequence, IdlString, IdlStruct, IdlUnion, Shape
from uoarm_rtm._texts import write_text, write_wchar

__all__ = ["writer"]

_ZEROS = tuple(bytes(count) for count in range(8))


def writer(shape: Shape, order: Order, encoding: str) -> Callable[[Message], bytes]:
    """Return the function that makes the CDR of a message.

    It raises Misfit, KeyError, TypeError or another ordinary exception of the step that failed;
    `_explain.misfit_of` says which field that was. Padding is zero.
    """
    source = GeneratedFunction("def write(message):")
    source.line("out = bytearray()")
    walk = _WriterSource(source, order, encoding)
    walk.value(shape, "message")
    walk.flush()
    # What comes last is often most of it, pixels say: it is copied once, into the result.
    last = source.cut("out += ")
    source.line("return bytes(out)" if last is None else f"return b''.join((out, {last}))")
    return source.function("write")


class _WriterSource:
    """Writes the text for a shape; `run` holds scalars that wait to be packed together."""

    def __init__(self, source: GeneratedFunction, order: Order, encoding: str) -> None:
        self._source = source
        self._order = order
        self._encoding = encoding
        self._run: list[str] = []
        self._format = ""
        self._zeros = source.constant(_ZEROS)

    def value(self, shape: Shape, given: str) -> None:
        if isinstance(shape, IdlStruct):
            self._record(shape, given)
        elif isinstance(shape, IdlSequence):
            (self._block if is_block(shape) else self._list)(shape, given)
        elif isinstance(shape, IdlUnion):
            self._choice(shape, given)
        elif isinstance(shape, IdlEnum):
            self._pack("I", f"{self._positions(shape)}[{given}]")
        elif isinstance(shape, IdlString):
            self._align(4)
            make = self._source.constant(write_text(shape, self._order, self._encoding))
            self._octets(f"{make}({given})")
        elif shape.name == "wchar":
            self.flush()
            self._octets(f"{self._source.constant(write_wchar)}({given})")
        else:
            self._scalar(shape, given)

    def flush(self) -> None:
        """Write what waits."""
        if self._run:
            pack = self._source.constant(Struct(self._order + self._format).pack)
            self._source.line(f"out += {pack}({', '.join(self._run)})")
        self._run, self._format = [], ""

    def _octets(self, expression: str) -> None:
        self._source.line(f"out += {expression}")
        self._source.known(1)

    def _align(self, size: int) -> None:
        """Bring the position to a multiple of `size`, known or not."""
        gap = self._source.gap(size)
        self.flush()
        if gap is None:
            self._source.line(f"out += {self._zeros}[-len(out) & {size - 1}]")
            self._source.known(size)
        elif gap:
            self._source.line(f"out += {self._zeros}[{gap}]")
            self._source.advance(gap)

    def _pack(self, code: str, expression: str) -> None:
        size = SIZES[code]
        gap = self._source.gap(size)
        if gap is None:
            self._align(size)
        elif gap:
            self._format += f"{gap}x"
            self._source.advance(gap)
        self._format += code
        self._run.append(expression)
        self._source.advance(size)

    def _scalar(self, scalar: IdlScalar, given: str) -> None:
        name = self._source.name()
        kind = {"f": "float", "d": "float"}.get(CODES[scalar.name], "int")
        check = self._source.constant(checker(scalar.name))
        self._source.line(f"{name} = {given}")
        if scalar.name in {"boolean", "char"}:
            self._source.line(f"{name} = {check}({name})")
        else:
            self._source.line(f"if type({name}) is not {kind}: {name} = {check}({name})")
        self._pack(CODES[scalar.name], name)

    def _record(self, record: IdlStruct, given: str) -> None:
        name = self._source.name()
        self._source.line(f"{name} = {given}")
        self._source.line(f"if len({name}) != {len(record.fields)}: raise KeyError")
        for field in record.fields:
            self.value(field.shape, f"{name}[{field.name!r}]")

    def _block(self, listing: IdlSequence, given: str) -> None:
        assert isinstance(listing.element, IdlScalar)
        size = SIZES[CODES[listing.element.name]]
        make = self._source.constant(blocks(listing, self._order))
        number, data = self._source.name(), self._source.name()
        self._source.line(f"{number}, {data} = {make}({given})")
        if listing.fixed:
            self._align(size)
            self._source.line(f"out += {data}")
            self._source.known(size)
            return
        self._pack("I", number)
        self.flush()
        if size > 4:  # noqa: PLR2004 - an empty sequence ends after its length, unpadded
            self._source.line(f"if {number}: out += {self._zeros}[-len(out) & {size - 1}]")
        self._source.line(f"out += {data}")
        self._source.known(min(size, 4))

    def _list(self, listing: IdlSequence, given: str) -> None:
        source = self._source
        name, element = source.name(), source.name()
        count = source.constant(counted(listing))
        source.line(f"{name} = {given}")
        if listing.fixed:
            source.line(f"{count}({name})")
        else:
            self._pack("I", f"{count}({name})")
        self.flush()
        source.line(f"for {element} in {name}:")
        source.depth += 1
        source.known(1)
        self.value(listing.element, element)
        self.flush()
        source.depth -= 1
        source.known(1)

    def _choice(self, choice: IdlUnion, given: str) -> None:
        source = self._source
        name, switch = source.name(), source.name()
        source.line(f"{name} = {given}")
        source.line(f"{switch} = {name}[{SWITCH!r}]")
        self.value(choice.by, switch)
        self.flush()
        modulus, rest = source.modulus, source.rest
        word = "if"
        for variant in sorted(choice.variants, key=lambda variant: not variant.labels):
            labels = source.constant(variant.labels)
            source.line(f"{word} {switch} in {labels}:" if variant.labels else f"{word} True:")
            word = "elif"
            source.depth += 1
            source.known(modulus, rest)
            source.line(f"if len({name}) != 2: raise KeyError")
            self.value(variant.shape, f"{name}[{variant.name!r}]")
            self.flush()
            source.depth -= 1
        source.line(f"elif len({name}) != 1: raise KeyError")
        source.known(1)

    def _positions(self, enumeration: IdlEnum) -> str:
        positions = {label: index for index, label in enumerate(enumeration.labels)}
        return self._source.constant(positions)
