"""Checks of live messages against their declared structure, octets and buffers included."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import lru_cache
from itertools import islice
from typing import TYPE_CHECKING, Any

from attrs import define, field

from uoarm._encodable import encodable, is_encodable, shown
from uoarm._hints.arrays import has_masked
from uoarm._mistakes import mistakes
from uoarm._raised import contained, text_of
from uoarm._spelling import Speller
from uoarm._support.yaml import Path, clip
from uoarm.bridge._compiled_check import Accepts, compile_check, judging
from uoarm.errors import MessageError
from uoarm.model import Message, MessageStructure, Schema

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError
    from jsonschema.protocols import Validator

_LOOKED_AT = 50  # mistakes; those of other items of a list that are alike are said once
_SHOWN = 10
_LONGEST = 300  # characters of a sentence
_OF_NAMES = frozenset({"additionalProperties", "patternProperties"})
_PLAIN = frozenset({list, dict, tuple})


def message_check(structure: MessageStructure, place: str) -> Callable[[Message], None]:
    """Return what raises MessageError for a message of another structure.

    In time that grows with the message, also where the structure has patterns or unique items; but
    for patterns that look back or around, which `re` reads.

    Args:
        structure: what the messages must match.
        place: the port, for the error's text.
    """
    judgement = _judgement(structure)
    accepts = judgement.accepts

    def check(message: Message) -> None:
        try:
            if accepts(message):
                return
            mismatch = judgement.mismatch(message)
        # Both may go as deep as the message, which a peer chose: it is refused, and no thread ends.
        except RecursionError:
            raise MessageError(f"{place}: the message is nested too deep") from None
        except BaseException as error:  # an array compared with a known value raises, say
            why = text_of(contained(error))
            text = f"{place}: the message cannot be held against its structure: {why:.200}"
            raise MessageError(text) from error
        if mismatch:
            raise MessageError(f"{place}: {mismatch}")

    return check


@define(eq=False)
class _Judgement:
    """What is said of the messages of one structure: quickly of most, in full of all."""

    schema: Schema
    accepts: Accepts = field(init=False)
    _scope: Callable[[], AbstractContextManager[None]] = field(default=nullcontext, init=False)
    _validator: Validator | None = field(default=None, init=False)

    def __attrs_post_init__(self) -> None:
        self.accepts = accepts = compile_check(self.schema, self._judge)
        keywords = frozenset(_names_in(self.schema))
        # What a dynamic reference leads to depends on the way to it.
        if "$ref" in keywords and not keywords & {"$dynamicRef", "$dynamicAnchor"}:
            self._scope = judging

            def remembering(message: Message) -> bool:
                with judging():
                    return accepts(message)

            self.accepts = remembering

    def mismatch(self, message: Message) -> str:
        """Return all that is wrong with a message, and where; nothing where it matches."""
        speller = Speller()
        reports: dict[tuple[Path, str], str] = {}
        with self._scope():
            for error in islice(self._whole().iter_errors(message), _LOOKED_AT):
                path, sentence = _sentence(error, speller)
                alike = tuple("*" if isinstance(part, int) else part for part in path), sentence
                place = encodable(".".join(map(str, path))) or "the message"
                reports.setdefault(alike, f"{place}: {_shorten(sentence)}")
        return "; ".join(
            [*list(reports.values())[:_SHOWN], *(["..."] if len(reports) > _SHOWN else [])]
        )

    def _judge(self, part: Schema) -> Accepts:
        validator: Validator | None = None

        def accepts(value: Message) -> bool:
            nonlocal validator
            if validator is None:
                validator = self._whole().evolve(schema=part)
            return validator.is_valid(value)

        return accepts

    def _whole(self) -> Validator:
        """Return the whole validator, made when the first message needs it: its import is slow."""
        if self._validator is None:
            from uoarm.bridge._full_validator import validator_of  # noqa: PLC0415 - slow

            self._validator = validator_of(self.schema)
        return self._validator


# One for all routes of a structure, in all threads. It changes only in `_whole`, without a lock:
# where two first mismatches come at once they make the same twice, and either serves.
@lru_cache(maxsize=256)
def _judgement(structure: MessageStructure) -> _Judgement:
    return _Judgement(structure.schema)


def _names_in(schema: Any) -> Iterator[str]:
    """Give the names of all members in a schema: its keywords, and what looks like one."""
    waiting = [schema]
    while waiting:
        value = waiting.pop()
        if isinstance(value, Mapping):
            yield from value
            waiting += value.values()
        elif isinstance(value, list | tuple):
            waiting += value


def _sentence(error: ValidationError, speller: Speller) -> tuple[Path, str]:
    """Return the place and what is wrong; the validator names one missing field in each error.

    Where a field is missing, those that the structure says nothing of are named, too: one of them
    may be what was meant.
    """
    path: Path = tuple(error.absolute_path)
    rules: Any = error.schema
    value: Any = error.instance
    if path and not isinstance(path[-1], str) and error.validator in _OF_NAMES:
        return path, f"expected a name that is text, got {_write(path[-1])}"
    if path and not is_encodable(str(path[-1])):
        return path, "a name without half of a surrogate pair was expected"
    if error.validator == "required" and isinstance(value, Mapping):
        missing = [name for name in rules["required"] if name not in value]
        names = list(map(repr, missing))
        text = f"the field {names[0]} is missing"
        if len(missing) > 1:
            text = f"the fields {', '.join(names[:-1])} and {names[-1]} are missing"
        are_known = "additionalProperties" in rules or "patternProperties" in rules
        others = () if are_known else value.keys() - rules.get("properties", {})
        return path, "; ".join([text, *_unknown(others, missing, speller)])
    if error.validator == "additionalProperties":
        known = rules.get("properties", {})
        hint = speller.guess_or_list(str(path[-1]), known, "known fields")
        return path, f"unknown field ({hint})"
    path, sentence, hint, _ = next(mistakes(error, speller, _write))
    return path, f"{sentence} ({hint})" if hint and error.validator != "type" else sentence


def _unknown(names: Iterable[object], missing: list[str], speller: Speller) -> Iterator[str]:
    for name in sorted(map(str, names))[:_SHOWN]:
        hint = speller.guess(name, missing)
        yield f"the field {clip(name)} is unknown{hint and f' ({hint})'}"


def _write(value: Any) -> str:
    """Put a value of a message into words; long ones are not looked at as a whole."""
    if isinstance(value, str | int | float | None):
        return clip(value)
    if isinstance(value, memoryview) and value.ndim != 1:
        return f"octets in {value.ndim} dimensions"
    if isinstance(value, bytes | bytearray | memoryview):
        return f"{len(value)} octets"
    if getattr(value, "ndim", 0):
        masked = " with masked items" if has_masked(value) else ""
        return f"an array of {' x '.join(map(str, value.shape))} {value.dtype}{masked}"
    text, kind = shown(value), type(value)
    # Some look like what was expected: a UserDict as a dict.
    return (
        text if kind in _PLAIN or kind.__name__ in text else f"{text} of the class {kind.__name__}"
    )


def _shorten(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
