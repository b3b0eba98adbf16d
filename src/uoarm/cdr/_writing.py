"""Generated functions that serialise messages.

The text takes values of the exact type at once and packs runs of numbers together; whatever else
comes goes to a checker. A long array, as in an image, stays a part of its own: to append it would
copy it into memory that grows, which costs ten times what one join of all parts does.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, TypeAlias

from uoarm.cdr._layout import (
    SIZES,
    SWITCH,
    ArrayLayout,
    BooleanLayout,
    ByteOrder,
    CharacterLayout,
    Encoding,
    EnumerationLayout,
    Layout,
    NumberLayout,
    RecordLayout,
    TextLayout,
    UnionLayout,
)
from uoarm.cdr._source import WHOLE, Index, PlaceCheck, SourceText
from uoarm.cdr._values import (
    array_writer,
    check_octets,
    checker,
    element_taker,
    is_block,
    label_check,
    member_check,
    text_writer,
    write_wide_character,
)
from uoarm.model import MOST_OCTETS, Message

Part: TypeAlias = "bytes | bytearray | memoryview"

HEADERS: dict[ByteOrder, bytes] = {"<": b"\0\1\0\0", ">": b"\0\0\0\0"}
"""What stands before encapsulated values of either byte order: plain CDR, version 1."""

_LONG = 65_536  # octets from which on an array is a part of its own
_MAX_BLOCKS = 8  # CPython compiles no more than twenty within one another
_WIDEST = 8
_ZEROS = tuple(bytes(count) for count in range(_WIDEST))


@lru_cache(maxsize=1024)
def writer(
    layout: Layout, encoding: Encoding, order: ByteOrder
) -> Callable[[Message], Sequence[Part]]:
    """Return the function that serialises a message, header included; padding is zero.

    It raises UnfitValue, or what the step that failed does; `explain` names the member.
    """
    source = SourceText("def made(v):", encoding, WHOLE)
    header = HEADERS[order] if encoding.is_encapsulated else b""
    source.line(f"out = bytearray({source.constant(header) if header else ''})")
    has_parts = _has_blocks(layout)
    if has_parts:
        source.line("parts = []; n = 0")
    writing = _WritingText(source, encoding, order, has_parts=has_parts)
    source.path = ("$",)
    writing.value(layout, "v")
    writing.flush()
    source.line("return (*parts, out)" if has_parts else "return (out,)")
    return source.function()


@lru_cache(maxsize=256)
def _part_writer(layout: Layout, encoding: Encoding, order: ByteOrder) -> Callable[..., Any]:
    """Return the function that adds a value behind what is there."""
    source = SourceText("def made(v, out, parts, n):", encoding, 1)
    writing = _WritingText(source, encoding, order, has_parts=True)
    writing.value(layout, "v")
    writing.flush()
    source.line("return out, n")
    return source.function()


def _has_blocks(layout: Layout) -> bool:
    """Say whether there may be a long array."""
    if isinstance(layout, RecordLayout):
        return any(_has_blocks(member) for _, member in layout.members)
    if isinstance(layout, UnionLayout):
        return any(_has_blocks(member.layout) for member in layout.members)
    if not isinstance(layout, ArrayLayout):
        return False
    return is_block(layout.element) or _has_blocks(layout.element)


class _WritingText:
    """Writes the lines for a layout; `run` holds numbers that wait to be packed together.

    In the text, `out` are the octets behind the last part, of which `n` are in `parts`.
    """

    def __init__(
        self, source: SourceText, encoding: Encoding, order: ByteOrder, *, has_parts: bool
    ) -> None:
        self._source = source
        self._before = "- n " if has_parts else ""
        self._encoding = encoding
        self._order = order
        self._blocks = 0
        self._format = ""
        self._run: list[str] = []
        self._checks: list[PlaceCheck] = []
        self._zeros = source.constant(_ZEROS)

    def value(self, layout: Layout, place: str) -> None:
        """Write what serialises a value; `place` is the expression for it."""
        if isinstance(layout, RecordLayout):
            self._record(layout, place)
        elif isinstance(layout, NumberLayout):
            self._number(layout, place)
        elif isinstance(layout, TextLayout):
            self._text(layout, place)
        elif isinstance(layout, ArrayLayout):
            (self._block if is_block(layout.element) else self._list)(layout, place)
        elif isinstance(layout, BooleanLayout):
            self._checked(checker(layout), "B", place, "{0} is not True and {0} is not False")
        elif isinstance(layout, UnionLayout):
            self._union(layout, place)
        elif isinstance(layout, EnumerationLayout):
            self._checked(label_check(layout), "I", place)
        else:
            self._character(layout, place)

    def flush(self) -> None:
        """Write the line that packs all numbers that were gathered."""
        if self._format:
            pack = self._source.constant(struct.Struct(self._order + self._format).pack)
            self._source.line(f"out += {pack}({', '.join(self._run)})", *self._checks)
        self._format, self._run, self._checks = "", [], []

    def _pack(self, code: str, variable: str) -> None:
        size = SIZES[code]
        gap = self._source.gap(size)
        if gap is None:
            self._align(size)
        elif gap:
            self._format += f"{gap}x"
            self._source.advance(gap)
        self._format += code
        self._run.append(variable)
        self._source.advance(size)

    def _align(self, size: int, condition: str = "") -> None:
        """Fill up to a multiple of a size that only the message knows the way to."""
        self.flush()
        start = self._encoding.header_size if size == _WIDEST else 0
        place = f"{start or ''} {self._before}- len(out) & {size - 1}"
        self._source.line(f"{condition}out += {self._zeros}[{place}]")
        self._source.known(size)

    def _checked(
        self, check: Callable[[Message], Any], code: str, place: str, doubt: str = ""
    ) -> None:
        """Gather a value that passes the check, which is asked where there is doubt."""
        source, name = self._source, self._source.variable()
        asked = source.constant(check)
        if doubt:
            source.line(f"{name} = {place}")
            source.line(f"if {doubt.format(name)}: {name} = {asked}({name})")
        else:
            source.line(f"{name} = {asked}({place})")
        self._pack(code, name)

    def _number(self, layout: NumberLayout, place: str) -> None:
        kind = "float" if layout.bounds is None else "int"
        check = checker(layout)
        self._checked(check, layout.code, place, f"type({{0}}) is not {kind}")
        # What `struct` refuses, such as an integer that is too large, is found among these.
        self._checks.append(PlaceCheck(self._source.path, self._run[-1], check))

    def _record(self, layout: RecordLayout, place: str) -> None:
        source, path, checks = self._source, self._source.path, self._source.checks
        name = source.variable()
        check = member_check(member for member, _ in layout.members)
        source.line(f"{name} = {place}")
        failure = source.constant(check)
        source.checks = (PlaceCheck(path, name, check),)
        source.line(f"if len({name}) != {len(layout.members)}: {failure}({name})")
        for member, inner in layout.members:
            source.path = (*path, f".{member}")
            self.value(inner, f"{name}[{member!r}]")
        source.path, source.checks = path, checks
        if not layout.members and self._encoding.is_encapsulated:
            self._format += "x"  # C has no empty structures: one octet stands for it
            source.advance(1)

    def _character(self, layout: CharacterLayout, place: str) -> None:
        if not layout.is_wide:
            self._checked(checker(layout), "B", place)
            return
        self.flush()
        write = self._source.constant(write_wide_character)
        self._source.line(f"out += {write}({place})")
        self._source.known(1)

    def _text(self, layout: TextLayout, place: str) -> None:
        source, octets, length = self._source, self._source.variable(), self._source.variable()
        function = text_writer(layout, self._encoding, self._order)
        write = source.constant(function)
        if layout.is_wide:
            source.line(f"{length}, {octets} = {write}({place})")
        elif layout.bound is not None:
            source.line(f"{octets} = {write}({place})")
            length = f"len({octets})"
        else:
            given, closing = source.variable(), self._encoding.is_aligned
            source.line(f"{given} = {place}")
            test = f"type({given}) is str" + (f" and '\\0' not in {given}" if closing else "")
            charset = "" if self._encoding.charset == "utf-8" else repr(self._encoding.charset)
            plain = f"{given}.encode({charset})" + (" + b'\\0'" if closing else "")
            source.line(
                f"{octets} = {plain} if {test} else {write}({given})",
                PlaceCheck(source.path, given, function),
            )
            length = f"len({octets})"
        self._pack("I", length)
        self.flush()
        source.line(f"out += {octets}")
        source.known(1)

    def _block(self, layout: ArrayLayout, place: str) -> None:
        source, element = self._source, layout.element
        size = SIZES[element.code] if isinstance(element, NumberLayout) else 1
        length, octets = source.variable(), source.variable()
        write = source.constant(array_writer(layout, self._order))
        source.line(f"{length}, {octets} = {write}({place})")
        if not layout.is_fixed:
            self._pack("I", length)
        self.flush()
        gap = source.gap(size)
        if gap is None:  # an empty array ends behind its length
            self._align(size, "" if layout.is_fixed else f"if {length}: ")
        elif gap:
            condition = "" if layout.is_fixed else f"if {length}: "
            source.line(f"{condition}out += {self._zeros}[{gap}]")
            source.advance(gap)
        if layout.is_fixed:
            source.advance(size * (layout.size or 0))
        else:
            source.known(min(size, 4))
        if layout.is_fixed and size * (layout.size or 0) < _LONG:
            source.line(f"out += {octets}")
            return
        source.line(f"if len({octets}) < {_LONG}: out += {octets}")
        source.line("else:")
        source.depth += 1
        source.line(f"parts += (out, {octets}); n += len(out) + len({octets}); out = bytearray()")
        source.line(f"{source.constant(check_octets)}(n)")
        source.depth -= 1

    def _list(self, layout: ArrayLayout, place: str) -> None:
        source, path, checks = self._source, self._source.path, self._source.checks
        name, index, element = source.variable(), source.variable(), source.variable()
        source.line(f"{name} = {source.constant(element_taker(layout))}({place})")
        if not layout.is_fixed:
            self._pack("I", f"len({name})")
        self.flush()
        source.line(f"for {index}, {element} in enumerate({name}):")
        source.path, source.checks = (*path, Index(index)), ()
        source.depth += 1
        self._blocks += 1
        source.known(1)
        if self._blocks < _MAX_BLOCKS:
            self.value(layout.element, element)
            self.flush()
        else:
            part = source.constant(_part_writer(layout.element, self._encoding, self._order))
            if self._before:
                source.line(f"out, n = {part}({element}, out, parts, n)")
            else:
                source.line(f"{part}({element}, out, None, 0)")
        # One large text may stand in a list a million times.
        source.line(f"if len(out) > {MOST_OCTETS}: {source.constant(check_octets)}(len(out))")
        self._blocks -= 1
        source.depth -= 1
        source.path, source.checks = path, checks
        source.known(1)

    def _union(self, layout: UnionLayout, place: str) -> None:
        source, path, checks = self._source, self._source.path, self._source.checks
        name, switch = source.variable(), source.variable()
        source.line(f"{name} = {place}")
        source.checks = (PlaceCheck(path, name, _switch_check),)
        source.line(f"{switch} = {name}[{SWITCH!r}]")
        source.path = (*path, f".{SWITCH}")
        self.value(layout.by, switch)
        self.flush()
        known = source.modulus, source.rest
        word = "if"
        for member in layout.members:
            labels = source.constant(member.labels)
            source.path = path
            test = "True" if member.labels is None else f"{switch} in {labels}"
            source.line(f"{word} {test}:")
            word = "elif"
            source.depth += 1
            source.known(*known)
            check = member_check((SWITCH, member.name))
            source.line(f"if len({name}) != 2: {source.constant(check)}({name})")
            source.checks = (PlaceCheck(path, name, check),)
            source.path = (*path, f".{member.name}")
            self.value(member.layout, f"{name}[{member.name!r}]")
            self.flush()
            source.depth -= 1
        source.path = path
        check = member_check((SWITCH,))
        source.line(f"elif len({name}) != 1: {source.constant(check)}({name})")
        source.path, source.checks = path, checks
        source.known(1)


def _switch_check(value: Message) -> None:
    """Raise UnfitValue unless there is a switch in what stands for a union."""
    if not hasattr(value, "keys") or SWITCH not in value:
        member_check((SWITCH,))(value)
