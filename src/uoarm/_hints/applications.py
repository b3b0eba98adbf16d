"""Messages of applications as the types that they ask for, and their values as messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, cast

from typing_extensions import TypeVar

from uoarm._hints.arrays import HintError
from uoarm._hints.convert import fault_of, plain_inside, reader
from uoarm._hints.schemas import schema_of
from uoarm.errors import MessageError, UsageError
from uoarm.model import Message, Schema
from uoarm.schema import CheckBudget, SchemaError, Verdict, check

if TYPE_CHECKING:
    from uoarm._wire import Form

T = TypeVar("T", default=Any)
"""What the messages of a connection are given as; without `as_type` the plain values."""

_SECONDS = 10.0
_REASONS = 5


class MessageType(Generic[T]):
    """A type that an application wants messages as, compiled once.

    Args:
        hint: the type: anything that components may have as a hint.
        place: of what, for errors: `function 'scan'`.
        form: in which messages come, and their schemas are; None: logical values.

    Raises:
        UsageError: the hint has no message structure, or no such values can be made.
    """

    def __init__(self, hint: Any, place: str, form: Form | None = None) -> None:
        self._name = getattr(hint, "__name__", str(hint))
        self._place = place
        try:
            schema = schema_of(hint)
            self._reader = reader(hint, place)
        except HintError as error:
            raise UsageError(f"as_type of {place}: {error}") from error
        self._schema: Schema = schema if form is None else form.schema(schema)
        self._decode = None if form is None else form.reader(schema)
        self._proven: Schema | None = None

    def read(self, message: Message) -> T:
        """Return the value of a message.

        Raises:
            MessageError: it is none, although its structure was proven to be.
        """
        if self._decode is not None:
            message = self._decode(message)
        return cast("T", message if self._reader is None else self._reader(message))

    def callback(self, callback: Callable[[T], None]) -> Callable[[Message], None]:
        """Return what calls a callback with the values of messages."""
        if self._reader is None and self._decode is None:
            return callback
        return lambda message: callback(self.read(message))

    def require(self, schema: Schema) -> None:
        """Prove that every message of a schema is such a value; quick for the same one again.

        Raises:
            UsageError: one may not be; the text says which and why.
        """
        if schema is self._proven:
            return
        try:
            verdict = check(schema, self._schema, budget=CheckBudget(seconds=_SECONDS))
        except SchemaError as error:
            raise UsageError(f"{self._place}: its structure is no JSON Schema: {error}") from error
        if not verdict.compatible:
            raise UsageError(self._refusal(verdict))
        self._proven = schema

    def _refusal(self, verdict: Verdict) -> str:
        if verdict.undecided is not None:
            reports = [f"it cannot be decided: {verdict.undecided}"]
        else:
            reports = [
                f"{reason.path}: {reason.sentence}" if reason.path else reason.sentence
                for reason in verdict.reasons[:_REASONS]
            ]
            more = len(verdict.reasons) - _REASONS
            reports += [f"and {more} more"] if more > 0 else []
        lines = "".join(f"\n  - {line}" for line in reports)
        return (
            f"{self._place} may give messages that are no {self._name}:{lines}\n"
            f"change {self._name}, or leave `as_type` out for plain values"
        )


def as_message(value: Any, place: str) -> Message:
    """Return the message that an application means by a value, whatever objects are in it.

    Dataclasses, attrs classes, named tuples, pydantic models and enumerations become plain values,
    and so do numbers of numpy; its arrays and other buffers stay what they are.

    Raises:
        MessageError: an object holds something else than its own hints say.
    """
    try:
        return plain_inside(value)
    except RecursionError:
        raise MessageError(f"{place}: the message is nested too deep") from None
    except Exception as error:
        where, kind = fault_of(value), type(value).__name__
        text = f"{where}: {error}" if where else str(error)
        raise MessageError(f"{place}: this is no {kind}: {text}") from error
