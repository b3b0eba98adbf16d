"""Functions as TypeScript declarations, beside those of `uoarm.js`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator

from uoarm._types._shape import (
    Array,
    Literals,
    Plain,
    RecordReference,
    RecordShape,
    RobotTypes,
    Shape,
    Table,
    Union,
    notes_of,
)

_HEAD = """/** Messages of a robot; made by `uoarm types --typescript`, not to be edited. */

import type { RequestOptions, Robot, Stream } from "./uoarm.js";

/** Wide ones come as bigint with `binary`, without as their digits; `BigInt(value)` reads all. */
export type Integer = number | bigint | `${bigint}`;
/** Without `binary` what JSON has no number for comes as text; `Number(value)` reads all. */
export type Real = Integer | "NaN" | "Infinity" | "-Infinity";
/** Base64, and with `binary` a Uint8Array; a list may be sent. */
export type Octets = string | Uint8Array | number[];
/** With `binary` arrays of numbers may come as typed arrays. */
export type Numbers<T> =
  | T[] | Int8Array | Uint8Array | Uint8ClampedArray | Int16Array | Uint16Array | Int32Array
  | Uint32Array | BigInt64Array | BigUint64Array | Float32Array | Float64Array;
"""
_TAIL = """
/** What `Robot` does, by the names of the functions: `(await connect(url)) as TypedRobot`. */
export type TypedRobot = Omit<Robot, "request" | "call"> & {
  request<N extends keyof Outputs>(
    name: N, options?: RequestOptions,
  ): Promise<Stream<Outputs[N]>>;
  call<N extends keyof Requests>(
    name: N, message: Requests[N], options?: { timeout?: number },
  ): Promise<Replies[N]>;
};
"""
_PLAIN = {
    "any": "unknown", "never": "never", "null": "null", "boolean": "boolean", "integer": "number",
    "wide": "Integer", "number": "Real", "string": "string", "octets": "Octets",
}  # fmt: skip
_NUMBERS = {"integer", "wide", "number"}


def write_typescript(robot: RobotTypes) -> str:
    """Return the declarations: the same text for the same functions."""
    lines = [_HEAD]
    text = " | ".join(json.dumps(name) for name in robot.functions)
    lines.append(f"export type FunctionName = {text or 'never'};")
    for root in robot.roots:
        for record in root.records:
            lines += ["", *_record(record)]
        if root.shape != RecordReference(root.name):
            note = _comment(notes_of(root.shape))
            lines += ["", f"export type {root.name} = {_type(root.shape)};{note}"]
    outputs, inputs, requests, replies = [], [], [], []
    for name, function in robot.functions.items():
        outputs += [*function.names(name)]
        if not function.outputs and not function.request and not function.refused:
            outputs.append((name, "never"))
        inputs += [(f"{name}.{port}", kind) for port, kind in function.inputs.items()]
        if function.request and function.reply:
            requests.append((name, function.request))
            replies.append((name, function.reply))
    lines += _table("Outputs", "What functions give, by the names that `request` takes.", outputs)
    lines += _table("Inputs", "What functions take, as `function.input`.", inputs)
    lines += _table("Requests", "What services are asked.", requests)
    lines += _table("Replies", "What services answer.", replies)
    return "\n".join(lines) + "\n" + _TAIL


def _table(name: str, what: str, rows: Iterable[tuple[str, str]]) -> Iterator[str]:
    yield f"\n/** {what} */\nexport interface {name} {{"
    for key, kind in rows:
        yield f"  {json.dumps(key)}: {kind};"
    yield "}"


def _record(record: RecordShape) -> Iterator[str]:
    yield f"export interface {record.name} {{"
    for key, (shape, required) in record.members.items():
        mark, note = "" if required else "?", _comment(notes_of(shape))
        yield f"  {json.dumps(key)}{mark}: {_type(shape)};{note}"
    if record.note:
        yield f"  [member: string]: unknown;{_comment([record.note])}"
    yield "}"


def _type(shape: Shape) -> str:
    match shape:
        case Plain():
            return _PLAIN[shape.kind]
        case Literals():
            return " | ".join(json.dumps(value) for value in shape.values)
        case Array():
            return _array(shape)
        case Table():
            return f"{{ [member: string]: {_type(shape.values)} }}"
        case Union():
            return " | ".join(dict.fromkeys(_type(part) for part in shape.parts))
        case RecordReference():
            return shape.name


def _array(shape: Array) -> str:
    parts = shape.items.parts if isinstance(shape.items, Union) else (shape.items,)
    if any(_may_be_numbers(part) for part in parts):
        return f"Numbers<{_type(shape.items)}>"
    if shape.tuple is not None:
        return f"[{', '.join(_type(item) for item in shape.tuple)}]"
    return f"({_type(shape.items)})[]"


def _may_be_numbers(part: Shape) -> bool:
    if isinstance(part, Literals):
        return any(isinstance(value, int) for value in part.values)
    return isinstance(part, Plain) and part.kind in _NUMBERS


def _comment(notes: Iterable[str]) -> str:
    reports = [note for note in dict.fromkeys(notes) if note]
    return f" // {'; '.join(reports)}" if reports else ""
