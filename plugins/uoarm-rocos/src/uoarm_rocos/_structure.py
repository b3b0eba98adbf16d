"""Fields of a catalogue as message structures: JSON Schema with exact ranges and units."""

from __future__ import annotations

import keyword
import math
import operator
from collections.abc import Callable, Mapping
from numbers import Integral
from typing import Any, ClassVar

import attrs

from uoarm.bridge import Description, foreign, text_of
from uoarm.errors import MessageError
from uoarm.model import MOST_OCTETS, MessageStructure, closed_object, elements_of, octets_of
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    BooleanField,
    DeviceCatalogue,
    Direction,
    Field,
    Fields,
    IntegerField,
    ListField,
    NumberField,
    OctetsField,
    StringField,
    StructField,
)
from uoarm_rocos._framing import WireError

_OCTET = {"type": "integer", "minimum": 0, "maximum": 255}


def describe(api: Api, direction: Direction | None) -> Description:
    """Return the structures of an API: of one direction of a flow, or (None) of a service."""
    sides = {
        Direction.INPUT: structure_of(api.input, f"{api.name}.input"),
        Direction.OUTPUT: structure_of(api.output, f"{api.name}.output"),
    }
    if api.kind is ApiKind.FLOW and direction is not None:
        return Description(message=sides[direction])
    return Description(request=sides[Direction.INPUT], reply=sides[Direction.OUTPUT])


def structure_of(fields: Fields, native_type: str = "") -> MessageStructure:
    """Return the structure of a message with these fields: a closed object."""
    return MessageStructure(_object(fields), native_type=native_type)


def _object(fields: Fields) -> dict[str, Any]:
    properties = {name: _schema(member.type) for name, member in fields.items()}
    return closed_object(properties, [name for name in fields if fields[name].required])


def _schema(kind: Field) -> dict[str, Any]:
    if isinstance(kind, BooleanField):
        return {"type": "boolean"}
    if isinstance(kind, IntegerField):
        return _named(
            {"type": "integer", "minimum": kind.minimum, "maximum": kind.maximum},
            **{"x-unit": kind.unit or None},
        )
    if isinstance(kind, NumberField):
        return _named(
            {"type": "number"},
            minimum=kind.minimum,
            maximum=kind.maximum,
            **{"x-unit": kind.unit or None, "x-nonfinite": kind.nonfinite or None},
        )
    if isinstance(kind, StringField):
        choices = list(kind.choices) or None
        return _named({"type": "string"}, enum=choices, maxLength=kind.max_length)
    if isinstance(kind, OctetsField):
        octets = {"type": "array", "items": _OCTET, "x-octets": True}
        return _named(octets, maxItems=kind.max_length)
    if isinstance(kind, ListField):
        return _named(
            {"type": "array", "items": _schema(kind.items)},
            minItems=kind.min_items or None,
            maxItems=kind.max_items,
        )
    return _object(kind.members)


def _named(schema: dict[str, Any], **keywords: object) -> dict[str, Any]:
    schema.update({key: value for key, value in keywords.items() if value is not None})
    return schema


_SHOWN = 40
_OBJECT = (dict, Mapping)  # a dict is recognised without the slow check of an abstract class


class _UnfitError(Exception):
    """A value that does not fit; each container on its way out puts its step before the path."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text, self.path = text, ""


def fit(fields: Fields, message: object, where: str) -> dict[str, Any]:
    """Return a message as values of exactly these fields; `where` begins the path in errors.

    Whole floats are taken for integers, integers for numbers, buffers and lists of 0 to 255 for
    octets, octets and anything with `tolist` (numpy, array) for lists.

    Raises:
        WireError: with the path of the first field that does not fit, what was expected and what
            came.
    """
    try:
        return _members(fields, message)
    except _UnfitError as error:
        raise WireError(f"{where}{error.path}: {error.text}") from None


def fit_given(fields: Fields, message: object, where: str) -> dict[str, Any]:
    """Return what `fit` does, of a message that goes to a device: its sender is blamed.

    Raises:
        MessageError: as the WireError of `fit`.
    """
    try:
        return foreign(fit, fields, message, where)
    except WireError as error:
        raise MessageError(str(error)) from None
    except Exception as error:  # of a value's own methods, or of one that changes meanwhile
        raise MessageError(f"{where}: {text_of(error)}") from error


def _members(fields: Fields, message: object) -> dict[str, Any]:
    if not isinstance(message, _OBJECT):
        raise _wrong("an object", message)
    if not message.keys() <= fields.keys():
        name = next((name for name in message if name not in fields), None)
        known = ", ".join(fields) or "none"
        raise _UnfitError(f"there is no field {str(name)[:_SHOWN]!r}; there are {known}")
    values = {}
    for name, member in fields.items():
        if name in message:
            kind = member.type
            try:
                values[name] = _FITTERS[type(kind)](kind, message[name])
            except _UnfitError as error:
                error.path = f".{name}{error.path}"
                raise
        elif member.required:
            raise _UnfitError(f"the field {name!r} is missing")
    return values


def _boolean(kind: BooleanField, value: Any) -> bool:
    del kind
    if isinstance(value, bool):
        return value
    if type(value).__name__ in {"bool", "bool_"} and hasattr(value, "item"):
        return bool(value)
    raise _wrong("true or false", value)


def _integer(kind: IntegerField, value: Any) -> int:
    if isinstance(value, bool):
        raise _wrong("an integer", value)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    try:
        number = operator.index(value)
    except TypeError:
        raise _wrong("an integer", value) from None
    if not kind.minimum <= number <= kind.maximum:
        raise _wrong(f"{kind.minimum} to {kind.maximum}", value)
    return number


def _number(kind: NumberField, value: Any) -> float:
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__"):
        raise _wrong("a number", value)
    try:
        number = float(value)
    except (OverflowError, TypeError, ValueError):
        raise _wrong("a number of 64-bit float", value) from None
    if not kind.nonfinite and not math.isfinite(number):
        raise _wrong("a finite number", value)
    low = kind.minimum is not None and number < kind.minimum
    high = kind.maximum is not None and number > kind.maximum
    if low or high:
        bounds = ("any" if item is None else f"{item:g}" for item in (kind.minimum, kind.maximum))
        raise _wrong(" to ".join(bounds), value)
    return number


def _string(kind: StringField, value: Any) -> str:
    if not isinstance(value, str):
        raise _wrong("text", value)
    if kind.choices and value not in kind.choices:
        raise _wrong(f"one of {', '.join(kind.choices)}", value)
    if kind.max_length is not None and len(value) > kind.max_length:
        raise _wrong(f"at most {kind.max_length} characters", f"{len(value)} of them")
    return value


def _octets(kind: OctetsField, value: Any) -> bytes:
    if isinstance(value, str | Integral | float | Mapping) or value is None:
        raise _wrong("octets", value)
    try:
        octets = octets_of(value)
    except (TypeError, ValueError):
        raise _wrong("octets", value) from None
    if kind.max_length is not None and len(octets) > kind.max_length:
        raise _wrong(f"at most {kind.max_length} octets", f"{len(octets)} of them")
    return octets


def _list(kind: ListField, value: Any) -> list[Any]:
    most = math.inf if kind.max_items is None else kind.max_items
    items = value
    if hasattr(value, "tolist"):
        if (octets := memoryview(value).nbytes) > MOST_OCTETS:  # it repeats its values, perhaps
            raise _wrong(f"at most {MOST_OCTETS:,} octets", f"{octets:,} of them")
        items = value.tolist()
    if isinstance(items, bytes | bytearray):
        items = list(items)
    if not isinstance(items, list | tuple):
        raise _wrong("a list", value)
    items = elements_of(items)
    if not kind.min_items <= len(items) <= most:
        raise _wrong(f"{kind.min_items} to {most} items", f"{len(items)} of them")
    kind_of_items, fitted = kind.items, list[Any]()
    fitter = _FITTERS[type(kind_of_items)]
    try:
        for item in items:
            fitted.append(fitter(kind_of_items, item))
    except _UnfitError as error:
        error.path = f"[{len(fitted)}]{error.path}"
        raise
    return fitted


def _struct(kind: StructField, value: Any) -> dict[str, Any]:
    return _members(kind.members, value)


_FITTERS: dict[type, Callable[[Any, Any], Any]] = {
    BooleanField: _boolean,
    IntegerField: _integer,
    NumberField: _number,
    StringField: _string,
    OctetsField: _octets,
    ListField: _list,
    StructField: _struct,
}


def _wrong(expected: str, got: object) -> _UnfitError:
    shown = repr(got)
    shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."
    return _UnfitError(f"expected {expected}, got {shown} ({type(got).__name__})")


class ApiRecord:
    """What every generated record of fields can do; fields left out are None."""

    _fields: ClassVar[Fields] = {}
    _spelling: ClassVar[Mapping[str, str]] = {}
    _inner: ClassVar[Mapping[str, type[ApiRecord]]] = {}

    @classmethod
    def of(cls, message: object) -> Any:
        """Return a record of this class from a plain message.

        Raises:
            WireError: the message does not fit; the text names the field.
        """
        values = fit(cls._fields, message, cls.__qualname__)
        return cls(
            **{
                cls._spelling[name]: _wrapped(cls._fields[name].type, value, cls._inner.get(name))
                for name, value in values.items()
            }
        )

    def message(self) -> dict[str, Any]:
        """Return the record as a plain message.

        Raises:
            WireError: a field has a value that does not fit.
        """
        plain = {
            name: _plain(getattr(self, attribute))
            for name, attribute in self._spelling.items()
            if getattr(self, attribute) is not None
        }
        return fit(self._fields, plain, type(self).__qualname__)


class ApiClass:
    """One API of a catalogue: its facts, and the classes of what it takes and gives."""

    api: ClassVar[Api]
    Input: ClassVar[type[Any]]
    Output: ClassVar[type[Any]]


def api_classes(catalogue: DeviceCatalogue) -> dict[str, type[ApiClass]]:
    """Return a class for each API, by the API's name.

    `api_classes(catalogue)["speechGeneration"].Input(text="hello").message()` is a request.
    """
    return {name: _class(api) for name, api in catalogue.apis.items()}


def _class(api: Api) -> type[ApiClass]:
    name = _identifier(api.name)
    title = name[0].upper() + name[1:]
    body = {
        "__doc__": api.text or f"The API {api.name}.",
        "api": api,
        "Input": _record(f"{title}.Input", api.input),
        "Output": _record(f"{title}.Output", api.output),
    }
    return type(title, (ApiClass,), body)


def _record(title: str, fields: Fields) -> type[ApiRecord]:
    spelling: dict[str, str] = {}
    inner: dict[str, type[ApiRecord]] = {}
    for name, member in fields.items():
        spelt = _identifier(name)
        while spelt in spelling.values():
            spelt += "_"
        spelling[name] = spelt
        struct = _struct_of(member.type)
        if struct is not None:
            inner[name] = _record(f"{title}.{spelt[0].upper()}{spelt[1:]}", struct.members)
    attributes: dict[str, Any] = {
        spelling[name]: attrs.field(kw_only=True, default=attrs.NOTHING if field.required else None)
        for name, field in fields.items()
    }
    body: dict[str, Any] = {part.__name__: part for part in inner.values()}
    body.update(
        _fields=fields, _spelling=spelling, _inner=inner, __qualname__=title, __module__=__name__
    )
    made: type[ApiRecord] = attrs.make_class(
        title.rpartition(".")[2],
        attributes,
        bases=(ApiRecord,),
        class_body=body,
        frozen=True,
        slots=False,
    )
    return made


def _struct_of(kind: Field) -> StructField | None:
    while isinstance(kind, ListField):
        kind = kind.items
    return kind if isinstance(kind, StructField) else None


def _wrapped(kind: Field, value: Any, inner: type[ApiRecord] | None) -> Any:
    if inner is None:
        return value
    if isinstance(kind, ListField):
        return [_wrapped(kind.items, item, inner) for item in value]
    return inner.of(value)


def _plain(value: Any) -> Any:
    if isinstance(value, ApiRecord):
        return value.message()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _identifier(name: str) -> str:
    spelt = name.replace("-", "_").replace(".", "_").lstrip("_") or "field"
    taken = keyword.iskeyword(spelt) or spelt in {"of", "message"} or spelt[0].isdigit()
    return f"field_{spelt}" if taken else spelt
