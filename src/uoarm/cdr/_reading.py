"""Generated functions that make messages of octets.

Every length is compared with what is left before anything is made of it, so that nothing received
has more made of it than a fixed multiple of its own size, and no list more elements than allowed.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NoReturn

from attrs import define, field

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
    least_size,
)
from uoarm.cdr._source import WHOLE, Index, Path, SourceText
from uoarm.cdr._values import (
    UnfitValue,
    array_reader,
    boolean_of,
    is_block,
    text_reader,
    wide_character_of,
)
from uoarm.model import Budget, Message

_MAX_BLOCKS = 8  # CPython compiles no more than twenty within one another
_WIDEST = 8


@lru_cache(maxsize=1024)
def reader(
    layout: Layout, encoding: Encoding, order: ByteOrder, budget: Budget | None
) -> Callable[[Any], Message]:
    """Return the function that makes a message of octets, header included.

    It raises UnfitValue for what the octets hold, `struct.error` or ValueError where they end too
    early; `explain` names the member.

    Args:
        layout: of the message.
        encoding: of the octets.
        order: of the octets of a number.
        budget: of octets, and of the elements of all lists together; None: a list has no more
            elements than octets follow.
    """
    source = SourceText("def made(b):", encoding, WHOLE)
    source.path = ("$",)
    source.line("size = len(b)")
    if budget is not None:
        failure = source.constant(_too_large)
        source.line(f"if size > {budget.octets}: {failure}(size, {budget.octets})")
        source.line(f"k = {budget.elements}")
    reading = _ReadingText(source, encoding, order, budget, encoding.header_size)
    value = reading.value(layout)
    reading.settle()
    # More may follow: Fast DDS counts the padding of empty arrays, which it then leaves out.
    test = "o > size" if encoding.is_encapsulated else "o != size"
    source.line(f"if {test}: {source.constant(_wrong_size)}(size, o)")
    source.line(f"return {value}")
    return source.function()


@lru_cache(maxsize=256)
def _part_reader(
    layout: Layout, encoding: Encoding, order: ByteOrder, budget: Budget | None
) -> Callable[..., Any]:
    """Return the function that reads a value from any offset on, and where it ends."""
    source = SourceText("def made(b, o, k):", encoding, 1)
    source.line("size = len(b)")
    reading = _ReadingText(source, encoding, order, budget, None)
    value = reading.value(layout)
    reading.flush()
    source.line(f"return {value}, o, k")
    return source.function()


@define(eq=False)
class _ReadingText:
    """Writes the lines for a layout. `value` returns the expression of what was read.

    In the text, `b` are the octets and `o` is the offset; `k` is how many elements are left. Names
    in `run` are assigned when the run is flushed; `late` are the lines that then follow.
    """

    _source: SourceText
    _encoding: Encoding
    _order: ByteOrder
    _budget: Budget | None
    _start: int | None  # of the octets, until the text has `o`
    _blocks: int = field(default=0, init=False)
    _format: str = field(default="", init=False)
    _run: list[str] = field(factory=list, init=False)
    _late: list[tuple[Path, str]] = field(factory=list, init=False)

    def value(self, layout: Layout) -> str:
        if isinstance(layout, RecordLayout):
            return self._record(layout)
        if isinstance(layout, NumberLayout):
            return self._number(layout.code)
        if isinstance(layout, TextLayout):
            return self._text(layout)
        if isinstance(layout, ArrayLayout):
            return (self._block if is_block(layout.element) else self._list)(layout)
        if isinstance(layout, BooleanLayout):
            return self._boolean()
        if isinstance(layout, UnionLayout):
            return self._union(layout)
        if isinstance(layout, EnumerationLayout):
            return self._enumeration(layout)
        return self._character(layout)

    def flush(self) -> None:
        """Write the line that takes all numbers that were gathered."""
        if self._format:
            numbers = struct.Struct(self._order + self._format)
            take = self._source.constant(numbers.unpack_from)
            target = f"{', '.join(self._run)}, = " if self._run else ""
            if self._start is None:
                self._source.line(f"{target}{take}(b, o); o += {numbers.size}")
            else:
                end = self._start + numbers.size
                self._source.line(f"{target}{take}(b, {self._start}); o = {end}")
                self._start = None
            path = self._source.path
            for late, line in self._late:
                self._source.path = late
                self._source.line(line)
            self._source.path = path
        self._format, self._run, self._late = "", [], []

    def settle(self) -> None:
        """Have all numbers taken that were gathered, and `o` in the text."""
        self.flush()
        if self._start is not None:
            self._source.line(f"o = {self._start}")
            self._start = None

    def _record(self, layout: RecordLayout) -> str:
        source, path, members = self._source, self._source.path, []
        for name, member in layout.members:
            source.path = (*path, f".{name}")
            members.append(f"{name!r}: {self.value(member)}")
        source.path = path
        if not members and self._encoding.is_encapsulated:
            self._format += "x"  # C has no empty structures: one octet stands for it
            source.advance(1)
        return "{" + ", ".join(members) + "}"

    def _number(self, code: str) -> str:
        size = 1 if code == "?" else SIZES[code]
        gap = self._source.gap(size)
        if gap is None:
            self._align(size)
        elif gap:
            self._format += f"{gap}x"
            self._source.advance(gap)
        self._format += code
        self._run.append(self._source.variable())
        self._source.advance(size)
        return self._run[-1]

    def _align(self, size: int, condition: str = "") -> None:
        """Go to a multiple of a size that only the message knows the way to."""
        self.settle()
        start = self._encoding.header_size if size == _WIDEST else 0
        place = (
            f"(o + {size - 1 - start} & -{size}) + {start}"
            if start
            else f"o + {size - 1} & -{size}"
        )
        self._source.line(f"{condition}o = {place}")
        self._source.known(size)

    def _boolean(self) -> str:
        if not self._encoding.is_idl:
            return self._number("?")
        name = self._number("B")
        self._late.append(
            (self._source.path, f"{name} = {self._source.constant(boolean_of)}({name})")
        )
        return name

    def _enumeration(self, layout: EnumerationLayout) -> str:
        name, labels = self._number("I"), self._source.constant(layout.labels)
        failure = self._source.constant(_no_label)
        self._late.append(
            (self._source.path, f"if {name} >= {len(layout.labels)}: {failure}({name})")
        )
        self._late.append((self._source.path, f"{name} = {labels}[{name}]"))
        return name

    def _character(self, layout: CharacterLayout) -> str:
        if not layout.is_wide:
            name = self._number("B")
            self._late.append((self._source.path, f"{name} = chr({name})"))
            return name
        self.settle()
        name = self._source.variable()
        make = self._source.constant(wide_character_of)
        self._require("3")
        self._source.line(f"{name} = {make}(b[o:o + 3]); o += 3")
        self._source.known(1)
        return name

    def _require(self, octets: str) -> None:
        failure = self._source.constant(_cut_short)
        self._source.line(f"if {octets} > size - o: {failure}({octets}, size - o)")

    def _text(self, layout: TextLayout) -> str:
        source, length = self._source, self._number("I")
        self.settle()
        name, closing = source.variable(), self._encoding.is_aligned
        make = text_reader(layout, self._encoding, self._order)
        octets = f"4 * {length}" if layout.is_wide and not self._encoding.is_idl else length
        if layout.bound is not None and not self._encoding.is_idl:
            most = layout.bound + (closing and not layout.is_wide)
            failure = source.constant(_too_long)
            source.line(f"if {length} > {most}: {failure}({length}, {most})")
        if make is None:
            source.line(f"e = o + {octets}")
            charset, end = self._encoding.charset, "e - 1" if closing else "e"
            source.line(f"{name} = str(b[o:{end}], {charset!r}, 'replace'); o = e")
        else:
            self._require(octets)
            source.line(f"e = o + {octets}")
            source.line(f"{name} = {source.constant(make)}(b[o:e]); o = e")
        source.known(1)
        return name

    def _length(self, layout: ArrayLayout) -> str:
        """Read how many elements there are, or take what is fixed."""
        if layout.is_fixed:
            self.settle()
            return str(layout.size)
        length = self._number("I")
        self.settle()
        if layout.size is not None:
            failure = self._source.constant(_too_many)
            self._source.line(f"if {length} > {layout.size}: {failure}({length}, {layout.size})")
        return length

    def _block(self, layout: ArrayLayout) -> str:
        source, length, name = self._source, self._length(layout), self._source.variable()
        element = layout.element
        size = SIZES[element.code] if isinstance(element, NumberLayout) else 1
        gap = source.gap(size)
        if gap is None:  # an empty array ends behind its length
            self._align(size, "" if layout.is_fixed else f"if {length}: ")
        elif gap:
            source.line(f"o += {gap}" if layout.is_fixed else f"if {length}: o += {gap}")
            source.advance(gap)
        octets = length if size == 1 else f"{size} * {length}"
        if not isinstance(element, NumberLayout):
            self._require(octets)
            if self._budget is not None:
                self._spend(length)
        read = source.constant(array_reader(layout, self._order, self._encoding))
        source.line(f"{name} = {read}(b, {length}, o); o += {octets}")
        if layout.is_fixed:
            source.advance(size * (layout.size or 0))
        else:
            source.known(min(size, 4))
        return name

    def _spend(self, length: str) -> None:
        failure = self._source.constant(_too_much)
        self._source.line(f"k -= {length}")
        self._source.line(f"if k < 0: {failure}()")

    def _list(self, layout: ArrayLayout) -> str:
        source, length, name = self._source, self._length(layout), self._source.variable()
        least = least_size(layout.element)
        # Of nothing there may be as many as there are octets, or as the structure says.
        if least or (self._budget is None and not layout.is_fixed):
            self._require(f"{least} * {length}" if least > 1 else length)
        if self._budget is not None:
            self._spend(length)
        index, path = source.variable(), source.path
        source.line(f"{name} = []")
        source.line(f"for {index} in range({length}):")
        source.path = (*path, Index(index))
        source.depth += 1
        self._blocks += 1
        source.known(1)
        made = self._element(layout.element)
        source.line(f"{name}.append({made})")
        self._blocks -= 1
        source.depth -= 1
        source.path = path
        source.known(1)
        return name

    def _element(self, layout: Layout) -> str:
        if self._blocks < _MAX_BLOCKS:
            made = self.value(layout)
            self.settle()
            return made
        name, left = self._source.variable(), "0" if self._budget is None else "k"
        part = _part_reader(layout, self._encoding, self._order, self._budget)
        target = "_" if self._budget is None else "k"
        self._source.line(f"{name}, o, {target} = {self._source.constant(part)}(b, o, {left})")
        return name

    def _union(self, layout: UnionLayout) -> str:
        source, path = self._source, self._source.path
        source.path = (*path, f".{SWITCH}")
        switch, name = self.value(layout.by), source.variable()
        self.settle()
        known = source.modulus, source.rest
        word = "if"
        for member in layout.members:
            labels = source.constant(member.labels)
            test = "True" if member.labels is None else f"{switch} in {labels}"
            source.line(f"{word} {test}:")
            word = "elif"
            source.path = (*path, f".{member.name}")
            source.depth += 1
            source.known(*known)
            made = self.value(member.layout)
            self.settle()
            source.line(f"{name} = {{{SWITCH!r}: {switch}, {member.name!r}: {made}}}")
            source.depth -= 1
        source.line(f"else: {name} = {{{SWITCH!r}: {switch}}}")
        source.path = path
        source.known(1)
        return name


def _wrong_size(size: int, end: int) -> None:
    raise UnfitValue(
        f"it is cut short: {size:,} octets of at least {end:,}"
        if end > size
        else f"{size:,} octets came, {end:,} were expected"
    )


def _failing(text: str) -> Callable[..., NoReturn]:
    """Return what a generated function calls, with the numbers of the text, to refuse octets."""

    def fail(*numbers: int) -> NoReturn:
        raise UnfitValue(text.format(*numbers))

    return fail


_too_large = _failing("{:,} octets came, {:,} are allowed")
_cut_short = _failing("it is cut short: {:,} octets should follow, and {:,} do")
_too_many = _failing("expected at most {1} elements, got {0}")
_too_long = _failing("expected a text of at most {1} octets or units, got {0}")
_too_much = _failing("it holds more elements than are allowed")
_no_label = _failing("enumerator number {} does not exist")
