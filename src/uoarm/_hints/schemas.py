"""Message structures from Python type hints."""

from __future__ import annotations

import dataclasses
import enum
import inspect
import operator
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from typing import (
    Annotated,
    Any,
    Final,
    Literal,
    Union,
    get_args,
    get_origin,
)
from weakref import WeakKeyDictionary

import attrs
from typing_extensions import NotRequired, ReadOnly, Required, get_type_hints, is_typeddict

from uoarm._hints.arrays import (
    HintError,
    OctetsMark,
    Range,
    Shape,
    array_of,
    is_class,
    scalar_of,
    unwrapped,
)
from uoarm._raised import text_of
from uoarm.model import closed_object

if sys.version_info >= (3, 14):
    from annotationlib import Format

_OCTET_ARRAY: Mapping[str, object] = {
    "type": "array",
    "items": {"type": "integer", "minimum": 0, "maximum": 255},
    "x-octets": True,
}
_SIMPLE: Mapping[object, Mapping[str, object]] = {
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
    str: {"type": "string"},
    bytes: _OCTET_ARRAY,
    bytearray: _OCTET_ARRAY,
    memoryview: _OCTET_ARRAY,
    None: {"type": "null"},
    types.NoneType: {"type": "null"},
}
QUALIFIERS = frozenset({Required, NotRequired, ReadOnly, Final})
_BUFFERS = (bytes, bytearray, memoryview)
# To evaluate the hints of a class takes most of the time of describing a component, and is asked
# for again and again. Any thread; two that find the same do no harm.
_KNOWN: WeakKeyDictionary[type, Mapping[str, Any]] = WeakKeyDictionary()
_MAX_DEPTH = 32


def schema_of(hint: Any, depth: int = 0) -> Mapping[str, object]:
    """Return the JSON Schema of a type hint: closed objects, every field required.

    Understands bool, int, float, str, bytes, None, Literal, Enum, unions, list, tuple, dict,
    TypedDict (NotRequired too), dataclasses, attrs classes, NamedTuple, pydantic models, numpy's
    numbers and `NDArray`, and Annotated with `Range` and `Shape`.

    Raises:
        HintError: the hint has no message structure; the text names it.
    """
    hint = unwrapped(hint)
    for kind, schema in _SIMPLE.items():  # not `in`: a hint may have no hash
        if hint is kind:
            return schema
    if depth > _MAX_DEPTH:
        raise HintError(f"the type hint {hint!r} is nested too deep or recursive")
    if is_enum(hint):
        return _flags(hint) if issubclass(hint, enum.Flag) else _members(hint)
    if is_model(hint):
        return _model(hint)
    numbers = scalar_of(hint) or array_of(hint)
    if numbers is not None:
        notes = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        return _annotated(numbers.schema, [note for note in notes if not isinstance(note, Shape)])
    fields = fields_of(hint)
    if fields is not None:
        return _object(fields, depth)
    return _generic(hint, depth)


def is_plain(hint: Any, depth: int = 0) -> bool:
    """Say whether a message is already what a hint says of it, with nothing to convert.

    So it is for everything that a hint says nothing of, too. A list of numbers may be a numeric
    buffer; who wants one kind of these hints `NDArray`.
    """
    hint = unwrapped(hint)
    if is_enum(hint) or is_record(hint) or any(hint is buffer for buffer in _BUFFERS):
        return False
    if scalar_of(hint) is not None or array_of(hint) is not None:
        return False
    if depth > _MAX_DEPTH:
        return True  # its structure is refused
    if is_typeddict(hint):
        return all(is_plain(field, depth + 1) for field in _hints_of(hint).values())
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        is_octets = any(isinstance(note, OctetsMark) for note in arguments[1:])
        return is_octets or is_plain(arguments[0], depth)
    if origin is Literal:
        return not any(isinstance(argument, enum.Enum) for argument in arguments)
    if origin in {*QUALIFIERS, Union, types.UnionType, list, dict}:
        return all(is_plain(argument, depth + 1) for argument in arguments)
    return origin is not tuple


def is_record(kind: Any) -> bool:
    """Say whether values of a type have named fields, and are no dicts."""
    if not is_class(kind):
        return False
    return (
        dataclasses.is_dataclass(kind) or attrs.has(kind) or is_named_tuple(kind) or is_model(kind)
    )


def is_named_tuple(kind: Any) -> bool:
    """Say whether a type is a NamedTuple: fields by name, as of every other record."""
    return is_class(kind) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def is_enum(kind: Any) -> bool:
    return is_class(kind) and issubclass(kind, enum.Enum)


def is_model(kind: Any) -> bool:
    """Say whether a type is a model of pydantic, which its author must have imported."""
    # Another thread may be importing it at this moment.
    base = getattr(sys.modules.get("pydantic"), "BaseModel", None)
    return base is not None and is_class(kind) and issubclass(kind, base)


def _members(kind: type[enum.Enum]) -> Mapping[str, object]:
    values = [member.value for member in kind]
    if not values:
        raise HintError(f"the type hint {kind!r} has no members, of which a message could be")
    if not all(value is None or isinstance(value, bool | int | float | str) for value in values):
        text = f"members of the type hint {kind!r} are neither texts, numbers, truths nor None"
        raise HintError(text)
    return {"enum": values}


def _flags(kind: type[enum.Flag]) -> Mapping[str, object]:
    """Return the schema of flags: every sum of them is a value, too."""
    every = reduce(operator.or_, (member.value for member in kind), 0)
    if every & (every + 1):
        raise HintError(f"the flags of the type hint {kind!r} leave out bits: write an int")
    return {"type": "integer", "minimum": 0, "maximum": every}


def _generic(hint: Any, depth: int) -> Mapping[str, object]:
    origin, arguments = get_origin(hint), get_args(hint)
    if not arguments and (origin is not tuple or hint is typing.Tuple):  # noqa: UP006 - bare
        origin = None  # List and the like, which do not say what is in them
    if origin in QUALIFIERS:
        return schema_of(arguments[0], depth)
    if origin is Annotated:
        return _annotated(schema_of(arguments[0], depth), arguments[1:])
    if origin is Literal:
        plain = [item.value if isinstance(item, enum.Enum) else item for item in arguments]
        if any(isinstance(item, bytes) for item in plain):
            raise HintError(f"the type hint {hint!r} has octets, of which no message can be: bytes")
        return {"enum": plain}
    if origin in {Union, types.UnionType}:
        return {"anyOf": [schema_of(argument, depth + 1) for argument in arguments]}
    if origin is list:
        return {"type": "array", "items": schema_of(arguments[0], depth + 1)}
    if origin is tuple:
        return _tuple(arguments, depth)
    if origin is dict and arguments[0] is str:
        return {"type": "object", "additionalProperties": schema_of(arguments[1], depth + 1)}
    raise HintError(
        f"the type hint {hint!r} has no message structure: write a TypedDict or a dataclass of its "
        "fields, or list[float] and the like, or declare it with @uoarm.local.structure"
    )


def _annotated(schema: Mapping[str, object], notes: Iterable[object]) -> Mapping[str, object]:
    made = dict(schema)
    for note in notes:
        if isinstance(note, Range):
            bounds = {"minimum": note.minimum, "maximum": note.maximum}
            known = {key: value for key, value in bounds.items() if value is not None}
            made = dict(_bounded(made, known))
        elif isinstance(note, Shape):
            raise HintError("Shape belongs to arrays of numpy: Annotated[NDArray[...], Shape(...)]")
        elif isinstance(note, Mapping):
            made |= note
    return made


def _bounded(schema: Mapping[str, Any], bounds: Mapping[str, object]) -> Mapping[str, object]:
    """Return a schema with bounds of its numbers, which may be in arrays and choices."""
    if schema.get("items"):
        return {**schema, "items": _bounded(schema["items"], bounds)}
    for key in ("anyOf", "prefixItems"):
        if key in schema:
            return {**schema, key: [_bounded(part, bounds) for part in schema[key]]}
    return {**schema, **bounds}


def _tuple(arguments: tuple[Any, ...], depth: int) -> Mapping[str, object]:
    if len(arguments) == 2 and arguments[1] is Ellipsis:  # noqa: PLR2004 - tuple[X, ...]
        return {"type": "array", "items": schema_of(arguments[0], depth + 1)}
    count = len(arguments)
    if not arguments:
        return {"type": "array", "minItems": 0, "maxItems": 0}
    if any(getattr(argument, "__unpacked__", False) for argument in arguments):
        hint = types.GenericAlias(tuple, arguments)
        raise HintError(f"the type hint {hint!r} has no message structure: write a list")
    return {
        "type": "array",
        "prefixItems": [schema_of(argument, depth + 1) for argument in arguments],
        "items": False,
        "minItems": count,
    }


def fields_of(hint: Any) -> dict[str, tuple[Any, bool]] | None:
    """Return name to (hint, required) of a record type, None for any other."""
    if is_typeddict(hint):
        hints = _hints_of(hint)
        return {name: (value, _is_required(hint, name, value)) for name, value in hints.items()}
    if not is_record(hint):
        return None
    hints = _hints_of(hint)
    if is_named_tuple(hint):
        names = list(hint._fields)
    else:
        found: Iterable[Any] = attrs.fields(hint) if attrs.has(hint) else dataclasses.fields(hint)
        names = [item.name for item in found if item.init]
    return {name: (hints.get(name, Any), True) for name in names}


def _hints_of(kind: Any) -> Mapping[str, Any]:
    found = _KNOWN.get(kind)
    if found is None:
        found = _KNOWN[kind] = read_hints(kind, f"{kind!r}: the type hints of its fields")
    return found


def type_hints(value: Any, *, include_extras: bool = False) -> dict[str, Any]:
    """Return the type hints of a class or a callable, with what text within them names."""
    found = get_type_hints(value, include_extras=include_extras)
    if sys.version_info >= (3, 11):
        return found
    names = vars(sys.modules.get(value.__module__, typing))
    return {name: _named(hint, names) for name, hint in found.items()}


def _named(hint: Any, names: dict[str, Any]) -> Any:
    """Return a hint without text: CPython 3.10 leaves that of `list["Part"]` as it is."""
    if isinstance(hint, types.UnionType):
        return reduce(operator.or_, (_named(item, names) for item in hint.__args__))
    if type(hint) is not types.GenericAlias:
        return hint
    inner = (
        eval(item, names) if isinstance(item, str) else _named(item, names)  # noqa: S307 - a hint
        for item in hint.__args__
    )
    return types.GenericAlias(hint.__origin__, tuple(inner))  # type: ignore[arg-type]


def read_hints(value: Any, what: str) -> dict[str, Any]:
    """Return the type hints of a class or a callable, by name.

    Args:
        value: the class or the callable.
        what: they are, for the error's text.

    Raises:
        HintError: one of them cannot be evaluated, now at least.
    """
    try:
        return type_hints(value, include_extras=True)
    except Exception as error:
        text = f"{what} cannot be read: {text_of(error)}"
        if isinstance(error, NameError):
            text += "; import what they name at run time, not under TYPE_CHECKING alone"
        raise HintError(text) from error


def signature(function: Callable[..., Any]) -> inspect.Signature:
    """Return a callable's signature, as far as it is there without what its hints name."""
    if sys.version_info >= (3, 14):
        return inspect.signature(function, annotation_format=Format.STRING)
    else:  # noqa: RET505 - mypy knows of a version what is in branches alone
        return inspect.signature(function)


def _is_required(record: Any, name: str, hint: Any) -> bool:
    # What is within text, as of every module with postponed annotations, the class does not know.
    while (origin := get_origin(hint)) in {ReadOnly, Annotated}:
        hint = get_args(hint)[0]
    return origin is Required or (origin is not NotRequired and name in record.__required_keys__)


def _object(fields: Mapping[str, tuple[Any, bool]], depth: int) -> Mapping[str, object]:
    properties = {name: schema_of(hint, depth + 1) for name, (hint, _) in fields.items()}
    return closed_object(properties, [name for name, (_, needed) in fields.items() if needed])


def _model(model: Any) -> Mapping[str, object]:
    """Return pydantic's own schema of a model, without references, closed as other records are."""
    whole = model.model_json_schema(mode="serialization")
    definitions = whole.pop("$defs", {})
    for item in (whole, *definitions.values()):
        if "properties" in item:
            item.setdefault("additionalProperties", False)
            item["required"] = list(item["properties"])

    def inline(part: Any, depth: int) -> Any:
        if depth > _MAX_DEPTH * 4:
            raise HintError(f"the type hint {model!r} is nested too deep or recursive")
        if isinstance(part, list):
            return [inline(item, depth + 1) for item in part]
        if not isinstance(part, dict):
            return part
        if part.get("format") == "binary":
            text = f"pydantic writes the octets of {model!r} as text: use a dataclass with Octets"
            raise HintError(text)
        if isinstance(part.get("$ref"), str):
            definition = definitions[part["$ref"].rpartition("/")[2]]
            part = {**definition, **{key: value for key, value in part.items() if key != "$ref"}}
        return {key: inline(value, depth + 1) for key, value in part.items()}

    schema: Mapping[str, object] = inline(whole, 0)
    return schema
