"""Messages from CDR and to CDR: one generated function for each type, byte order and direction.

Readers compare every length with what is left of the buffer before anything is made of it, so
that no input allocates more than a fixed multiple of its own size. Arrays of numbers are views
into the buffer where its byte order is the machine's.

Writers check every value. The generated text takes the common case at once and packs runs of
scalars together. Whatever it cannot take goes to a checker; when that fails, `_codec.fit` walks
the message once more, slowly, to name the field.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from typing import Any

import numpy as np

from uoarm.model import Message
from uoarm_rtm._shape import (
    SWITCH,
    IdlEnum,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    IdlUnion,
    Shape,
    least_size,
)
from uoarm_rtm._values import (
    CODES,
    SIZES,
    IdlMismatch,
    Order,
    blocks,
    checker,
    counted,
    is_block,
    text_of,
    wchar_of,
    write_text,
    write_wchar,
)

__all__ = ["WIDEST", "GeneratedFunction", "reader", "writer"]

WIDEST = 8
"""Greatest alignment of CDR."""


class GeneratedFunction:
    """One function, line by line, that walks a CDR buffer.

    Nothing of a message ever enters the text: names of fields come in as quoted literals,
    everything else as a constant.

    While the text is written, `modulus` and `rest` say what is known of the position at that
    place: it is `rest` more than a multiple of `modulus`.
    """

    def __init__(self, head: str) -> None:
        self._lines = [head]
        self._constants: dict[str, object] = {}
        self._names = 0
        self.depth = 1
        self.modulus = WIDEST
        self.rest = 0

    def line(self, text: str) -> None:
        """Add a line at the present depth."""
        self._lines.append("    " * self.depth + text)

    def cut(self, head: str) -> str | None:
        """Take the last line back where it begins so, outside every block; return its rest."""
        begin = "    " + head
        return self._lines.pop()[len(begin) :] if self._lines[-1].startswith(begin) else None

    def name(self) -> str:
        """Return a variable's name that is not in use."""
        self._names += 1
        return f"v{self._names}"

    def constant(self, value: object) -> str:
        """Return a name by which the function's text may refer to a value."""
        name = f"c{len(self._constants)}"
        self._constants[name] = value
        return name

    def known(self, modulus: int, rest: int = 0) -> None:
        """Say what is known of the position from here on."""
        self.modulus, self.rest = modulus, rest

    def gap(self, size: int) -> int | None:
        """Return the padding before an item of this alignment; None: only known when running."""
        return None if size > self.modulus else -self.rest % size

    def advance(self, count: int) -> None:
        """Move the position by a known number of bytes."""
        self.rest = (self.rest + count) % self.modulus

    def function(self, name: str) -> Callable[..., Any]:
        """Compile the text."""
        names: dict[str, Any] = dict(self._constants)
        exec("\n".join(self._lines), names)  # noqa: S102 - our own text, see the class
        made: Callable[..., Any] = names[name]
        return made


def reader(shape: Shape, order: Order, encoding: str) -> Callable[[bytes], Message]:
    """Return the function that makes a message of CDR.

    It raises IdlMismatch for what the bytes hold and `struct.error` where they end too early.
    """
    source = GeneratedFunction("def read(data):")
    source.line("at = 0; size = len(data)")
    walk = _ReaderSource(source, order, encoding)
    made = walk.value(shape)
    walk.flush()
    text = source.constant(_left_over)
    source.line(f"if at != size: {text}(at, size)")
    source.line(f"return {made}")
    return source.function("read")


def _left_over(at: int, size: int) -> None:
    raise IdlMismatch(f"expected {at} bytes in all, got {size}")


class _ReaderSource:
    """Writes the text for a shape. `value` returns the expression of what was read.

    Names in `run` are assigned when the run is flushed; `late` are the checks that follow.
    """

    def __init__(self, source: GeneratedFunction, order: Order, encoding: str) -> None:
        self._source = source
        self._order = order
        self._encoding = encoding
        self._run: list[str] = []
        self._late: list[str] = []
        self._format = ""

    def value(self, shape: Shape) -> str:
        if isinstance(shape, IdlStruct):
            items = [f"{field.name!r}: {self.value(field.shape)}" for field in shape.fields]
            return f"{{{', '.join(items)}}}"
        if isinstance(shape, IdlSequence):
            return (self._block if is_block(shape) else self._list)(shape)
        if isinstance(shape, IdlUnion):
            return self._choice(shape)
        if isinstance(shape, IdlEnum):
            return self._enumeration(shape)
        if isinstance(shape, IdlString):
            return self._text(shape)
        if shape.name == "wchar":
            self.flush()
            return self._apply(wchar_of, "3")
        return self._scalar(shape)

    def flush(self) -> None:
        """Read what waits."""
        if self._run:
            layout = Struct(self._order + self._format)
            unpack = self._source.constant(layout.unpack_from)
            self._source.line(f"{', '.join(self._run)}, = {unpack}(data, at)")
            self._source.line(f"at += {layout.size}")
            for line in self._late:
                self._source.line(line)
        self._run, self._late, self._format = [], [], ""

    def _pack(self, code: str) -> str:
        size = SIZES[code]
        gap = self._source.gap(size)
        if gap is None:
            self._align(size)
        elif gap:
            self._format += f"{gap}x"
            self._source.advance(gap)
        name = self._source.name()
        self._format += code
        self._run.append(name)
        self._source.advance(size)
        return name

    def _align(self, size: int) -> None:
        gap = self._source.gap(size)
        self.flush()
        if gap is None:
            self._source.line(f"at = at + {size - 1} & -{size}")
            self._source.known(size)
        elif gap:
            self._source.line(f"at += {gap}")
            self._source.advance(gap)

    def _scalar(self, scalar: IdlScalar) -> str:
        name = self._pack(CODES[scalar.name])
        if scalar.name == "boolean":
            check = self._source.constant(_boolean)
            self._late.append(f"{name} = {check}({name})")
        elif scalar.name == "char":
            self._late.append(f"{name} = chr({name})")
        return name

    def _enumeration(self, enumeration: IdlEnum) -> str:
        name = self._pack("I")
        fail = self._source.constant(_no_label)
        self._late.append(f"if {name} >= {len(enumeration.labels)}: {fail}({name})")
        self._late.append(f"{name} = {self._source.constant(enumeration.labels)}[{name}]")
        return name

    def _count(self, listing: IdlSequence, least: int) -> str:
        """Read a length, or take the fixed one, and compare it with what is left."""
        if listing.fixed:
            self.flush()
            number = str(listing.size)
        else:
            number = self._pack("I")
            self.flush()
            if listing.size is not None:
                fail = self._source.constant(_too_many)
                size = listing.size
                self._source.line(f"if {number} > {size}: {fail}({number}, {size})")
        fail = self._source.constant(_too_long)
        self._source.line(f"if {number} * {least} > size - at: {fail}({number}, size - at)")
        return number

    def _apply(self, make: Callable[[bytes], Any], length: str) -> str:
        """Read so many bytes and make something of them."""
        name, end = self._source.name(), self._source.name()
        fail = self._source.constant(_too_long)
        self._source.line(f"{end} = at + {length}")
        self._source.line(f"if {end} > size: {fail}({length}, size - at)")
        self._source.line(f"{name} = {self._source.constant(make)}(data[at:{end}])")
        self._source.line(f"at = {end}")
        self._source.known(1)
        return name

    def _text(self, text: IdlString) -> str:
        number = self._pack("I")
        self.flush()
        encoding = self._encoding
        return self._apply(lambda data: text_of(data, text, encoding), number)

    def _block(self, listing: IdlSequence) -> str:
        assert isinstance(listing.element, IdlScalar)
        size = SIZES[CODES[listing.element.name]]
        number = self._count(listing, size)
        if listing.element.name == "octet":
            return self._apply(bytes, number)
        if listing.element.name in {"boolean", "char"}:
            return self._apply(_ITEMS[listing.element.name], number)
        if listing.fixed:
            self._align(size)
        elif size > 4:  # noqa: PLR2004 - an empty sequence ends after its length, unpadded
            self._source.line(f"if {number}: at = at + {size - 1} & -{size}")
        name = self._source.name()
        make = self._source.constant(_numbers(listing.element, self._order))
        fail = self._source.constant(_too_long)
        self._source.line(f"if at + {number} * {size} > size: {fail}({number} * {size}, size - at)")
        self._source.line(f"{name} = {make}(data, {number}, at)")
        self._source.line(f"at += {number} * {size}")
        self._source.known(min(size, 4))
        return name

    def _list(self, listing: IdlSequence) -> str:
        source = self._source
        number = self._count(listing, least_size(listing.element))
        name = source.name()
        source.line(f"{name} = []")
        source.line(f"for _ in range({number}):")
        source.depth += 1
        source.known(1)
        made = self.value(listing.element)
        self.flush()
        source.line(f"{name}.append({made})")
        source.depth -= 1
        source.known(1)
        return name

    def _choice(self, choice: IdlUnion) -> str:
        source = self._source
        switch, name = self.value(choice.by), source.name()
        self.flush()
        modulus, rest = source.modulus, source.rest
        word = "if"
        for variant in sorted(choice.variants, key=lambda variant: not variant.labels):
            labels = source.constant(variant.labels)
            source.line(f"{word} {switch} in {labels}:" if variant.labels else f"{word} True:")
            word = "elif"
            source.depth += 1
            source.known(modulus, rest)
            made = self.value(variant.shape)
            self.flush()
            source.line(f"{name} = {{{SWITCH!r}: {switch}, {variant.name!r}: {made}}}")
            source.depth -= 1
        source.line(f"else: {name} = {{{SWITCH!r}: {switch}}}")
        source.known(1)
        return name


def _numbers(scalar: IdlScalar, order: Order) -> Callable[[bytes, int, int], Any]:
    native = np.dtype(CODES[scalar.name])
    wire = native.newbyteorder(order)

    def make(data: bytes, count: int, at: int) -> Any:
        if not count:
            return np.empty(0, native)
        numbers = np.frombuffer(data, wire, count, at)
        return numbers if wire == native else numbers.astype(native)

    return make


def _boolean(value: int) -> bool:
    if value > 1:
        raise IdlMismatch(f"expected a boolean, 0 or 1, got {value}")
    return value == 1


def _no_label(value: int) -> None:
    raise IdlMismatch(f"enumerator number {value} does not exist")


def _too_many(number: int, size: int) -> None:
    raise IdlMismatch(f"expected at most {size} elements, got {number}")


def _too_long(number: int, left: int) -> None:
    raise IdlMismatch(
        f"a length of {number} goes beyond the end of the data, which is {left} bytes on"
    )


_ITEMS: dict[str, Callable[[bytes], Any]] = {
    "boolean": lambda data: list(map(_boolean, data)),
    "char": lambda data: list(data.decode("latin-1")),
}


_ZEROS = tuple(bytes(count) for count in range(8))


def writer(shape: Shape, order: Order, encoding: str) -> Callable[[Message], bytes]:
    """Return the function that makes the CDR of a message.

    It raises IdlMismatch, KeyError, TypeError or another ordinary exception of the step that
    failed; `_codec.fit` says at which field. Padding is zero.
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
