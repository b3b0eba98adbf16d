"""The floor as a graph: nodes that are 1.5 m apart, of which each vehicle holds those it may enter.

Shelves, docks and the vehicles' homes are nodes at the edge, with one neighbour each. Racks stand
where the grid has no node.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from typing import Final

__all__ = ["DOCKS", "HOMES", "NODES", "RACKS", "SHELVES", "neighbours", "node_at", "route"]

PITCH: Final = 1.5
_COLUMNS, _ROWS = 8, 5
_RACK_CELLS = ((2, 3), (3, 3), (5, 3), (6, 3))


def _grid() -> dict[str, tuple[int, int]]:
    cells = {
        f"n{column}{row}": (column, row)
        for column in range(1, _COLUMNS + 1)
        for row in range(1, _ROWS + 1)
        if (column, row) not in _RACK_CELLS
    }
    cells |= {f"shelf{number}": (2 * number, _ROWS + 1) for number in range(1, 5)}
    cells |= {f"dock{number}": (_COLUMNS + 1, 2 * number) for number in (1, 2)}
    return cells | {f"home{number}": (0, number) for number in range(1, 5)}


_CELLS: Final = _grid()
_AT: Final = {cell: name for name, cell in _CELLS.items()}

NODES: Final[Mapping[str, tuple[float, float]]] = {
    name: (PITCH * column, PITCH * row) for name, (column, row) in _CELLS.items()
}
"""Positions by name, in metres."""

SHELVES: Final = tuple(sorted(name for name in NODES if name.startswith("shelf")))
DOCKS: Final = tuple(sorted(name for name in NODES if name.startswith("dock")))
HOMES: Final = tuple(sorted(name for name in NODES if name.startswith("home")))
RACKS: Final = tuple((PITCH * column, PITCH * row) for column, row in _RACK_CELLS)
"""Centres of the racks, which no vehicle may touch."""

_EDGE: Final = frozenset((*SHELVES, *DOCKS, *HOMES))


def neighbours(node: str) -> tuple[str, ...]:
    """Return the nodes that one can drive to from a node; those at the edge have one each.

    Raises:
        KeyError: there is no such node.
    """
    column, row = _CELLS[node]
    around = ((column + 1, row), (column - 1, row), (column, row + 1), (column, row - 1))
    found = tuple(_AT[cell] for cell in around if cell in _AT)
    return tuple(text for text in found if text not in _EDGE or node not in _EDGE)


def route(start: str, goal: str, closed: Collection[str] = ()) -> tuple[str, ...] | None:
    """Return the shortest way, with both ends; None where there is none.

    Args:
        start: a node, closed or not.
        goal: a node.
        closed: nodes that may not be entered.

    Raises:
        KeyError: there is no such node.
    """
    before = {start: start}
    waiting = deque([start])
    while waiting:
        here = waiting.popleft()
        if here == goal:
            way = [here]
            while way[-1] != start:
                way.append(before[way[-1]])
            return tuple(reversed(way))
        for there in neighbours(here):
            passable = there not in _EDGE or there == goal
            if passable and there not in closed and there not in before:
                before[there] = here
                waiting.append(there)
    return None


def node_at(x: float, y: float, within: float = PITCH / 4) -> str | None:
    """Return the node around a position, None where it is between nodes.

    Args:
        x: metres.
        y: metres.
        within: metres to the node at most.
    """
    name = _AT.get((round(x / PITCH), round(y / PITCH)))
    if name is None:
        return None
    there = NODES[name]
    return name if (there[0] - x) ** 2 + (there[1] - y) ** 2 <= within**2 else None
