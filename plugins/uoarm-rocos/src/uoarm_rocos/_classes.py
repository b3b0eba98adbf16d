"""One generated class for each API, as the paper has it, beside plain messages."""

from __future__ import annotations

import keyword
from collections.abc import Mapping
from typing import Any, ClassVar

import attrs

from uoarm_rocos._catalogue import Api, DeviceCatalogue, Field, Fields, ListField, StructField
from uoarm_rocos._structure import fit

__all__ = ["ApiClass", "ApiRecord", "api_classes"]


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
