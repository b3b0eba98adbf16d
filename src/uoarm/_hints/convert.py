"""Messages as the values that hints describe, and back: by cattrs, compiled once for each hint.

cattrs, numpy and pydantic are imported only where a hint needs them. A hint that plain values
meet as they are (TypedDict of numbers and texts, lists of numbers) has no conversion but that of
1.0, an integer of JSON Schema, to the int that it says.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache, lru_cache, partial, reduce
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

import attrs
from typing_extensions import get_type_hints, is_typeddict

from uoarm._encodable import shown
from uoarm._hints.arrays import (
    HintError,
    OctetsMark,
    Shape,
    array_of,
    integer,
    number,
    scalar_of,
    truth,
    unwrapped,
)
from uoarm._hints.schemas import (
    QUALIFIERS,
    fields_of,
    is_enum,
    is_model,
    is_named_tuple,
    is_plain,
    is_record,
    signature,
    type_hints,
)
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Message, octets_of

if TYPE_CHECKING:
    from cattrs import Converter

_PRIMITIVES = (bool, int, float, str)
_Make = Callable[[Any], Any]
_FLAT = frozenset({*_PRIMITIVES, bytes, type(None)})


def reader(hint: Any, place: str) -> Callable[[Message], Any] | None:
    """Return what makes the value that a hint says of a message; None: the message is that.

    Args:
        hint: a type hint, or `inspect.Parameter.empty`.
        place: who takes the values, for errors.

    The function raises MessageError, with the path, for a message of another structure.

    Raises:
        HintError: no such value can be made.
    """
    if is_plain(hint):
        found = _found(_integers(hint))
        return partial(_converted, found) if found else None
    from cattrs import transform_error  # noqa: PLC0415 - slow import

    structure = _compiled(hint, place, _structure_hook)
    name = getattr(hint, "__name__", hint)

    def read(message: Message) -> Any:
        try:
            return structure(message, hint)
        except Exception as error:
            mistakes = "; ".join(
                transform_error(error, path="the message", format_exception=_sentence_of)
            )
            raise MessageError(f"{place} takes {name}: {mistakes}") from error

    return read


def _integers(hint: Any, within: tuple[Any, ...] = ()) -> dict[type, _Make | None]:
    """Return what makes integers of the floats in a value of a plain hint, by the value's class.

    None: a value of that class stays as it is, as a float does where the hint is `int | float`.
    """
    hint = unwrapped(hint)
    if hint is int:
        return {float: _integer}
    if hint is float or hint in within:
        return {float: None}
    if is_typeddict(hint):
        parts = {name: part for name, (part, _) in (fields_of(hint) or {}).items()}
        known = {name: _found(_integers(part, (*within, hint))) for name, part in parts.items()}
        fields = {name: found for name, found in known.items() if found}
        return {dict: partial(_in_fields, fields) if fields else None}
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in {Union, UnionType}:
        made: dict[type, _Make | None] = {}
        for part in arguments:
            for kind, make in _integers(part, within).items():
                made[kind] = None if kind in made else make  # which of two is not known
        return made
    if origin in {list, dict} and arguments:
        inner = _found(_integers(arguments[-1], within))
        make = partial(_in_list if origin is list else _in_values, inner) if inner else None
        return {origin: make}
    return _integers(arguments[0], within) if origin in {Annotated, *QUALIFIERS} else {}


def _found(integers: Mapping[type, _Make | None]) -> dict[type, _Make]:
    return {kind: make for kind, make in integers.items() if make is not None}


def _converted(found: Mapping[type, _Make], value: Any) -> Any:
    make = found.get(value.__class__)
    return value if make is None else make(value)


def _integer(value: float) -> Any:
    return int(value) if value.is_integer() else value  # what is none, a check refuses


def _in_fields(fields: Mapping[str, Mapping[type, _Make]], value: dict[str, Any]) -> Any:
    made = value  # which others get, too
    for name, found in fields.items():
        item = value.get(name)
        other = _converted(found, item)
        if other is not item:
            made = {**made, name: other}
    return made


def _in_values(found: Mapping[type, _Make], value: dict[str, Any]) -> Any:
    return _in_fields(dict.fromkeys(value, found), value)


def _in_list(found: Mapping[type, _Make], value: list[Any]) -> Any:
    if found.keys().isdisjoint(map(type, value)):
        return value
    return [_converted(found, item) for item in value]


def writer(hint: Any, place: str) -> Callable[[Any], Message] | None:
    """Return what makes a message of a value that should be as a hint says.

    None where such values are messages already; `plain` then takes what else comes.

    Args:
        hint: a type hint, or `inspect.Parameter.empty`.
        place: who gives the values, for errors.

    The function raises BridgeError, which blames the component, for a value of another type.

    Raises:
        HintError: values of this type make no messages.
    """
    if is_plain(hint):
        return None
    write = _compiled(hint, place, _converter().get_unstructure_hook)
    name = getattr(hint, "__name__", hint)
    own = hint if is_record(hint) else None

    def unstructure(value: Any) -> Message:
        try:
            return write(value) if own is None or value.__class__ is own else plain(value)
        except Exception as error:
            where = ".".join(_path_to_fault(hint, value))
            mistakes = f"{where}: {error}" if where else str(error)
            text = f"{place} gave something else than {name}: {mistakes}"
            raise BridgeError(text, FailureReason.BAD_MESSAGE) from error

    return unstructure


def _path_to_fault(hint: Any, value: Any) -> list[str]:
    """Return the fields that lead to what cannot be written, which cattrs does not name."""
    parts: dict[str, tuple[Any, Any]] = {}
    if is_record(value.__class__) and not is_model(value.__class__):
        hints = _field_hints(value.__class__)
        parts = {name: (item, getattr(value, name, None)) for name, item in hints.items()}
    elif isinstance(value, list | tuple):
        inner = (*get_args(hint), Any)[0]
        parts = {str(number): (inner, item) for number, item in enumerate(value)}
    elif isinstance(value, dict):
        hints = type_hints(hint, include_extras=True) if is_typeddict(hint) else {}
        inner = (*get_args(hint), Any)[-1]
        parts = {str(name): (hints.get(name, inner), item) for name, item in value.items()}
    for name, (part, item) in parts.items():
        try:
            _converter().get_unstructure_hook(_convertible(part))(item)
        except Exception:  # noqa: BLE001 - whatever the field raises, it is the one
            return [name, *_path_to_fault(part, item)]
    return []


def plain(value: Any) -> Message:
    """Return an object of a record class, an enumeration or numpy as plain values."""
    write = _write_of(value.__class__)
    return value if write is None else write(value)


def plain_inside(value: Any) -> Message:
    """Return plain values also of what is within lists, tuples and dicts; `value` where it is."""
    kind = value.__class__
    if kind in _FLAT:
        return value
    if kind is dict:
        made = {
            name: plain_inside(element)
            for name, element in value.items()
            if element.__class__ not in _FLAT
        }
        changed = any(value[name] is not element for name, element in made.items())
        return {**value, **made} if changed else value
    if kind is list or kind is tuple:
        if _FLAT.issuperset(map(type, value)):
            return value
        items = [plain_inside(element) for element in value]
        changed = any(element is not item for element, item in zip(value, items, strict=True))
        return items if changed else value
    return plain(value)


def fault_of(value: Any) -> str:
    """Return the path to what makes no message in a value; nothing where it is the value."""
    return ".".join(_path_to_fault(value.__class__, value))


@lru_cache(maxsize=1024)
def _write_of(kind: type) -> Callable[[Any], Message] | None:
    if kind.__module__ == "numpy" and issubclass(kind, str | bytes):
        return str if issubclass(kind, str) else bytes
    if is_record(kind) or is_enum(kind) or scalar_of(kind) is not None:
        hook: Callable[[Any], Message] = _converter().get_unstructure_hook(kind)
        return hook
    return None


def _compiled(hint: Any, place: str, get_hook: Callable[[Any], Any]) -> Any:
    try:
        return get_hook(_convertible(hint))
    except HintError as error:
        raise HintError(f"{place}: {error}") from error
    except Exception as error:
        text = f"{place}: the type hint {hint!r} cannot be converted: {error}"
        raise HintError(text) from error


def _structure_hook(hint: Any) -> Any:
    _require_readable(hint, set())
    return _structuring(hint, _converter())


def _require_readable(hint: Any, seen: set[Any]) -> None:
    """Refuse what cattrs only finds with the first message.

    Raises:
        TypeError: a class is not built of its fields, or a choice is of some of an enumeration.
        Exception: as cattrs has it, for a union in which also plain values are.
    """
    hint = unwrapped(hint)
    if is_model(hint):
        return
    parts = fields_of(hint)
    if parts is None:
        origin, arguments = get_origin(hint), get_args(hint)
        if origin is Literal:
            return
        if origin in {Union, UnionType}:
            kinds = [_convertible(part) for part in arguments if part is not NoneType]
            if len(kinds) > 1 and any(map(_is_of_members, kinds)):
                text = "beside other types an enumeration is read as a whole only"
                raise TypeError(f"{text}: write the enumeration in place of its Literal")
            classes = [
                part
                for part in arguments
                if get_origin(part) is not Literal
                and not any(unwrapped(part) is kind for kind in (*_PRIMITIVES, type(None)))
            ]
            if len(classes) > 1:
                _converter().get_structure_hook(Union[tuple(classes)])  # noqa: UP007 - of several
        for part in arguments:
            _require_readable(part, seen)
        return
    if hint in seen:
        return
    seen.add(hint)
    if _is_class(hint):
        found = attrs.fields(hint) if attrs.has(hint) else dataclasses.fields(hint)
        names = [getattr(item, "alias", item.name) for item in found if item.init]
        try:
            signature(hint).bind(**dict.fromkeys(names))
        except TypeError as error:
            text = f"{hint.__name__} cannot be built of its fields: {error}"
            raise TypeError(text) from None
    for part, _ in parts.values():
        _require_readable(part, seen)


def _is_of_members(hint: Any) -> bool:
    """Say whether a hint is a Literal of an enumeration's members."""
    return get_origin(hint) is Literal and any(isinstance(item, Enum) for item in get_args(hint))


def _sentence_of(error: BaseException, kind: type | None) -> str:
    del kind
    if isinstance(error, KeyError):
        return f"the field {error.args[0]!r} is missing"
    found = getattr(error, "errors", None)
    if callable(found):  # pydantic's, whose text is a page
        return "; ".join(f"{item['msg']} @ {'.'.join(map(str, item['loc']))}" for item in found())
    return str(error) or type(error).__name__


@cache
def _converter() -> Converter:
    """Return the converter of all hints; predicates that were registered last are asked first."""
    import cattrs  # noqa: PLC0415 - slow import
    from cattrs import cols, strategies  # noqa: PLC0415
    from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn, typeddicts  # noqa: PLC0415

    made = cattrs.Converter(structure_fallback_factory=_refuse)
    for kind in _PRIMITIVES:  # the structures were proven: nothing is coerced
        made.register_structure_hook(kind, _primitive)
    for octets in (bytes, bytearray, memoryview):
        made.register_structure_hook(octets, _octets)
        made.register_unstructure_hook(octets, _same)
    made.register_unstructure_hook(bool, truth)
    made.register_unstructure_hook(int, integer)
    made.register_unstructure_hook(float, number)
    made.register_unstructure_hook(str, _text)
    strategies.configure_union_passthrough(str | bool | int | float | None, made)
    made.register_structure_hook_factory(
        is_named_tuple,
        lambda kind: cols.namedtuple_dict_structure_factory(
            kind, made, **_fields(kind, made, is_read=True)
        ),
    )
    made.register_unstructure_hook_factory(
        is_named_tuple,
        lambda kind: cols.namedtuple_dict_unstructure_factory(
            kind, made, **_fields(kind, made, is_read=False)
        ),
    )
    made.register_structure_hook_factory(
        is_model, lambda kind: lambda value, _: kind.model_validate(value)
    )
    made.register_unstructure_hook_factory(
        is_model, lambda _: lambda value: value.model_dump(mode="json", by_alias=True)
    )
    made.register_structure_hook_factory(
        _is_class,
        lambda kind: make_dict_structure_fn(kind, made, **_fields(kind, made, is_read=True)),
    )
    made.register_unstructure_hook_factory(
        _is_class,
        lambda kind: make_dict_unstructure_fn(kind, made, **_fields(kind, made, is_read=False)),
    )
    made.register_structure_hook_factory(
        is_typeddict,
        lambda kind: typeddicts.make_dict_structure_fn(
            kind, made, **_fields(kind, made, is_read=True)
        ),
    )
    made.register_unstructure_hook_factory(
        is_typeddict,
        lambda kind: typeddicts.make_dict_unstructure_fn(
            kind, made, **_fields(kind, made, is_read=False)
        ),
    )
    made.register_unstructure_hook_factory(_is_choice, lambda _: plain_inside)
    made.register_structure_hook_factory(_numbers, lambda hint: _numbers(hint).read)
    made.register_unstructure_hook_factory(_numbers, lambda hint: _numbers(hint).write)
    made.register_structure_hook_factory(_is_passed, _passing)
    made.register_unstructure_hook_factory(_is_passed, lambda _: _same)
    return made


def _is_class(kind: Any) -> bool:
    return is_record(kind) and not is_named_tuple(kind) and not is_model(kind)


def _fields(kind: Any, made: Converter, *, is_read: bool) -> dict[str, Any]:
    """Return the hooks of fields whose hints say more than cattrs would see, or could take."""
    from cattrs.gen import override  # noqa: PLC0415 - slow import

    full, bare = _field_hints(kind), get_type_hints(kind)
    late = _late(kind, full)
    inner = {
        name: plainer
        for name, hint in full.items()
        if (plainer := _convertible(hint)) != bare[name] or hint != plainer or name in late
    }
    if is_read:
        return {
            name: override(struct_hook=_structuring(hint, made, is_late=name in late))
            for name, hint in inner.items()
        }
    return {
        name: override(
            unstruct_hook=partial(made.unstructure, unstructure_as=hint)
            if name in late
            else made.get_unstructure_hook(hint)
        )
        for name, hint in inner.items()
    }


def _field_hints(kind: Any) -> dict[str, Any]:
    """Return the hints of a record's fields: those of its class are of a ClassVar, too."""
    fields = fields_of(kind) or {}
    full = type_hints(kind, include_extras=True)
    return {name: hint for name, hint in full.items() if name in fields}


def _late(kind: Any, hints: Mapping[str, Any]) -> set[str]:
    """Return the fields with names in their types that were not there as the class was made.

    cattrs looks them up where a whole type is text alone. Their hooks are asked for with the first
    value, since such a name may be the class's own.
    """
    if not _is_class(kind):
        return set()
    found = attrs.fields(kind) if attrs.has(kind) else dataclasses.fields(kind)
    types = {item.name: item.type for item in found if item.name in hints}
    if any(isinstance(item, str) for item in types.values()):
        return set()
    return {name for name, item in types.items() if item != hints[name]}


def _structuring(hint: Any, made: Converter, *, is_late: bool = False) -> Callable[[Any, Any], Any]:
    """Return what makes values of a hint, whatever type it is called with."""
    if is_late:
        return lambda value, _: made.structure(value, hint)
    structure = made.get_structure_hook(hint)
    return lambda value, _: structure(value, hint)


def _convertible(hint: Any) -> Any:
    """Return a hint with no more notes than change its values: words of a schema have no hash."""
    hint = unwrapped(hint)
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in QUALIFIERS:
        return _convertible(arguments[0])
    if origin is Annotated:
        notes = [note for note in arguments[1:] if isinstance(note, Shape | OctetsMark)]
        inner = _convertible(arguments[0])
        return reduce(lambda made, note: Annotated[made, note], notes, inner)
    if origin in {None, Literal} or not arguments:
        return hint
    parts = tuple(map(_convertible, arguments))
    return reduce(operator.or_, parts) if origin is UnionType else origin[parts]


def _refuse(hint: Any) -> Any:
    raise TypeError(f"messages cannot be told apart as {hint!r}")


def _numbers(hint: Any) -> Any:
    """Return what a hint of numpy says; None for any other."""
    return scalar_of(hint) or array_of(hint)


def _is_choice(hint: Any) -> bool:
    """Say whether a hint is a union of more than one type and None, whose values say which."""
    return get_origin(hint) in {Union, UnionType} and len({*get_args(hint), NoneType}) > 2  # noqa: PLR2004


def _is_passed(hint: Any) -> bool:
    return not any(hint is item for item in _PRIMITIVES) and is_plain(hint)


def _passing(hint: Any) -> Callable[[Any, Any], Any]:
    found = _found(_integers(hint))
    return lambda value, _: _converted(found, value)


def _same(value: Any) -> Any:
    return value


def _primitive(value: Any, kind: Any) -> Any:
    if kind is int and value.__class__ is float:
        return _integer(value)
    # cattrs asks for what is a number or a text by its class, an IntEnum too.
    return value if kind in _PRIMITIVES else kind(value)


def _octets(value: Any, kind: Any) -> Any:
    if isinstance(value, kind) and getattr(value, "itemsize", 1) == 1:
        return value
    return kind(octets_of(value))


def _text(value: Any) -> Any:
    found = value.value if isinstance(value, Enum) else value
    if not isinstance(found, str):
        raise TypeError(f"expected a text, got {shown(value)}")
    return found
