"""The status map as text that a person can act on."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from functools import partial
from typing import Any

__all__ = ["format_status", "format_trouble"]

_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "machines": ("name", "present", "clock_offset", "clock_error", "cause"),
    "bridges": ("name", "plugin", "health", "process", "assigned", "facts", "cause"),
    "components": ("name", "function", "health", "failed", "lost", "cause"),
    "channels": ("component", "port", "facts"),
    "commands": (
        "component",
        "phase",
        "for",
        "left",
        "lifetime",
        "lease",
        "limits",
        "refused",
        "cause",
    ),
    "connections": ("id", "function", "state", "lost", "cause"),
    "routes": ("producer", "consumer", "received", "delivered", "rate", "dropped"),
    "offers": ("name", "state", "calls", "failed", "cause"),
    "lock": ("component", "port", "refused", "times", "cause"),
}
_OFTEN_NONE = frozenset({"machines", "channels", "commands", "offers", "lock"})


def format_status(status: Mapping[str, Any], width: int | None = None) -> str:
    """Return a status map, as data or as JSON has it, as one table for each kind of thing.

    Args:
        status: the map.
        width: characters that a line may have; a table that is wider is told row by row, each
            with the names of what it has. None: as many as there are.
    """
    held = status.get("held")
    lines = (
        [] if held is None else [f"commands have been refused for {held:.3f} s, until a release"]
    )
    for name, columns in _COLUMNS.items():
        found = _OF_CHANNELS[name](status) if name in _OF_CHANNELS else status.get(name, ())
        rows = [[_shown(item.get(column), column) for column in columns] for item in found]
        if name in _OFTEN_NONE and not rows:
            continue
        lines.append(f"{name}: {len(rows) or 'none'}")
        if rows:
            lines.extend(_table(columns, rows, width))
    return "\n".join(lines)


def format_trouble(status: Mapping[str, Any], connection: str) -> str:
    """Say what keeps messages of a connection from coming, for the end of a sentence.

    Args:
        status: the map, as data or as JSON has it.
        connection: its name.

    Returns:
        For what it waits, which of its components is not well, and why the last message between
        them was not taken; empty where nothing is known.
    """
    own = next((row for row in status.get("connections", ()) if row["id"] == connection), None)
    if own is None:
        return ""
    names = set(own["components"])
    causes = [f"the connection is {_word(own['state'])}: {own['cause']}"] if own["cause"] else []
    causes += [
        f"{component['name']} is {_word(component['health'])}: "
        f"{component['cause'] or component['last_error']}"
        for component in status.get("components", ())
        if component["name"] in names and _word(component["health"]) != "ok"
    ]
    for route in status.get("routes", ()):
        consumer, refusal = route["consumer"], route.get("refusal", "")
        is_own = consumer == connection or consumer.rpartition(".")[0] in names
        if is_own and refusal and not any(refusal in text for text in causes):
            ends = f"{route['producer']} -> {consumer}"
            causes.append(f"the last message of {ends} was refused: {refusal}")
    return "".join(f"; {text}" for text in causes)


def _word(value: Any) -> str:
    return str(getattr(value, "value", value))


def _commands(status: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the inputs that move something: what each was told last, and how long that holds."""
    return [
        {
            "component": f"{component['name']}.{channel['port'].partition('.')[2]}",
            "phase": report["phase"],
            "for": _seconds(report["since"]),
            "left": _seconds(report["left"]),
            "lifetime": _seconds(channel.get("lifetime")),
            "lease": _lease(channel.get("lease")),
            "limits": "; ".join(map(_limit, channel.get("limits", ()))),
            "refused": report["dropped"],
            "cause": report["cause"],
        }
        for component in status.get("components", ())
        for channel in component.get("channels", ())
        if (report := channel.get("command"))
    ]


def _lease(lease: Mapping[str, Any] | None) -> str:
    """Return who holds a lease and how long still, as `session 3 (driver), 0.400 s`."""
    if lease is None:
        return ""
    holder = lease["holder"]
    if holder is None:
        return "free"
    name = f"{holder['id']} ({holder['role']})" if holder["role"] else holder["id"]
    return f"{name}, {_seconds(lease['left'])}"


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.3f} s"


def _limit(limit: Mapping[str, Any]) -> str:
    """Return the limits of one number, as `linear.x at least -0.5, at most 0.5, 1 in a second`."""
    words = {"minimum": "at least {:g}", "maximum": "at most {:g}", "rate": "{:g} in a second"}
    report = (text.format(limit[key]) for key, text in words.items() if limit[key] is not None)
    return f"{limit['path']} {', '.join(report)}"


def _channels(status: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the channels of which anything is known, with the names of their components."""
    return [
        {"component": component["name"], **channel}
        for component in status.get("components", ())
        for channel in component.get("channels", ())
        if channel["facts"]
    ]


_OF_CHANNELS: Mapping[str, Callable[[Mapping[str, Any]], list[Mapping[str, Any]]]] = {
    "channels": _channels,
    "commands": _commands,
}


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], width: int | None) -> list[str]:
    widths = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    padded = (map(str.ljust, row, widths) for row in (columns, *rows))
    lines = [f"  {'  '.join(cells)}".rstrip() for cells in padded]
    if width is None or max(map(len, lines)) <= width:
        return lines
    return [line for row in rows for line in _record(columns, row, width)]


def _record(columns: Sequence[str], row: Sequence[str], width: int) -> Iterator[str]:
    """Yield a row as lines: its first cell, and what else it has with the names of the columns."""
    message = ", ".join(
        f"{name} {cell}" for name, cell in zip(columns[1:], row[1:], strict=True) if cell
    )
    for text, indent in ((row[0], "  "), (message, "    ")):
        wrap = partial(textwrap.wrap, initial_indent=indent, break_on_hyphens=False)
        yield from wrap(text, width, subsequent_indent=f"{indent}  ")


def _shown(value: object, column: str) -> str:
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{1000 * value:.3f} ms" if column.startswith("clock_") else f"{value:.1f}"
    if isinstance(value, list | tuple):
        return ", ".join(f"{item} {_fact(other)}" for item, other in value)
    return "" if value is None else str(value)


def _fact(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
