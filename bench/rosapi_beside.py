"""Descriptions of types beside those of rosbridge_suite's rosapi, for every type that is installed.

Needs a checkout of rosbridge_suite, of which `rosapi/src` and `rosbridge_library/src` are on the
PYTHONPATH, and ROS 2 beside `uoarm-ros2` and `uoarm-rosbridge`.
"""

from __future__ import annotations

import logging
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

_LATER = "_check_fields"  # a slot of messages that came after rosapi's descriptions were written
_SHOWN = 10


def main() -> int:
    """Print how many descriptions are equal, and the first that are not."""
    try:
        from uoarm_ros2._commands import installed  # noqa: PLC0415
        from uoarm_ros2._named_types import structure_of_type  # noqa: PLC0415
        from uoarm_rosbridge._typedefs import in_full, typedefs  # noqa: PLC0415

        theirs = _rosapi()
    except ImportError as error:
        print(f"no comparison: {error}", file=sys.stderr)
        return 0
    counts: Counter[str] = Counter()
    for name in installed():
        for spelling, kind, ending, describe in _questions(theirs, name):
            structure = structure_of_type(in_full(spelling, kind, ending), {})
            ours = None if structure is None else _plain(typedefs(structure, ""))
            try:
                wanted = _plain(describe(spelling))
            except Exception:  # noqa: BLE001 - what rosapi cannot describe ends in any error
                counts["fails there" if ours else "fails in both"] += 1
                continue
            outcome = "equal" if ours == wanted else "differ"
            counts[outcome] += 1
            if outcome == "differ" and counts[outcome] <= _SHOWN:
                print(f"{spelling}{ending}\n  there {wanted}\n  here  {ours}")
    print(", ".join(f"{outcome}: {count}" for outcome, count in sorted(counts.items())))
    return 0


def _questions(theirs: Any, name: str) -> Iterator[tuple[str, str, str, Any]]:
    """Yield a type in both spellings, with the part of it and what describes that there."""
    package, kind, own = name.split("/")
    parts: dict[str, list[tuple[str, Any]]] = {
        "msg": [("", theirs.get_typedef_recursive)],
        "srv": [
            ("_Request", theirs.get_service_request_typedef_recursive),
            ("_Response", theirs.get_service_response_typedef_recursive),
        ],
    }
    for ending, describe in parts.get(kind, ()):
        for spelling in (name, f"{package}/{own}"):
            yield spelling, kind, ending, describe


def _plain(found: list[dict[str, Any]]) -> object:
    """Return what must be equal: rosapi keeps the underscore of slots and bounds of arrays."""
    return [
        (
            one["type"],
            [name.removeprefix("_") for name in one["fieldnames"]],
            [re.sub(r", \d+$", "", kind) for kind in one["fieldtypes"]],
            one["fieldarraylen"],
            one["examples"],
        )
        for one in found
    ]


def _rosapi() -> Any:
    """Return rosapi's descriptions, given what the Python of this ROS 2 has and they expect not."""
    logging.disable(logging.CRITICAL)
    stand_in = ModuleType("rosidl_runtime_py")  # not on PyPI, and for texts of definitions only
    stand_in.get_interface_path = Path  # type: ignore[attr-defined]  # made here
    sys.modules.setdefault("rosidl_runtime_py", stand_in)
    from rosapi import objectutils  # type: ignore[import-not-found]  # noqa: PLC0415

    read = objectutils._handle_array_information  # noqa: SLF001 - the one place

    def without_later_slots(instance: Any) -> Any:
        slots = [slot for slot in instance.__slots__ if slot != _LATER]
        values = {slot: getattr(instance, slot) for slot in slots}
        kinds = instance._fields_and_field_types  # noqa: SLF001 - as rosapi reads it
        return read(SimpleNamespace(**values, __slots__=slots, _fields_and_field_types=kinds))

    objectutils._handle_array_information = without_later_slots  # noqa: SLF001
    return objectutils


if __name__ == "__main__":
    sys.exit(main())
