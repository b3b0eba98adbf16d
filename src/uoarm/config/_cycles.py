"""Dependency cycles between functions: which can be avoided, and which cannot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

__all__ = ["find_cycle", "groundable"]

Needs = Mapping[str, Sequence[frozenset[str]]]
"""For every function, what each of its components depends on."""


def groundable(needs: Needs) -> frozenset[str]:
    """Return the functions that have a component fed, in the end, by no cycle.

    The least fixpoint: a function is groundable when one of its components needs groundable
    functions only. Linear in the size of the configuration.
    """
    waiting: dict[str, list[tuple[str, int]]] = {}
    missing: dict[tuple[str, int], int] = {}
    ready: list[str] = []
    found: set[str] = set()
    for function, components in needs.items():
        for number, wanted in enumerate(components):
            missing[function, number] = len(wanted)
            for other in wanted:
                waiting.setdefault(other, []).append((function, number))
            if not wanted:
                ready.append(function)
    while ready:
        function = ready.pop()
        if function in found:
            continue
        found.add(function)
        for key in waiting.get(function, ()):
            missing[key] -= 1
            if missing[key] == 0:
                ready.append(key[0])
    return frozenset(found)


def find_cycle(edges: Mapping[str, Sequence[str]]) -> tuple[str, ...] | None:
    """Return the first cycle of a graph, its first node again at the end, or None."""
    done: set[str] = set()
    for root in edges:
        path: list[str] = []
        on_path: set[str] = set()
        stack = [(root, iter(edges.get(root, ())))]
        while stack:
            node, rest = stack[-1]
            if node not in on_path:
                if node in done:
                    stack.pop()
                    continue
                path.append(node)
                on_path.add(node)
            for other in rest:
                if other in on_path:
                    return (*path[path.index(other) :], other)
                if other not in done and other in edges:
                    stack.append((other, iter(edges[other])))
                    break
            else:
                done.add(node)
                on_path.discard(node)
                path.pop()
                stack.pop()
    return None
