"""How resolving grows: chains of 3 to 1,000 among 10,000 functions, beside pip's resolver."""

from __future__ import annotations

import time
from collections.abc import Callable

from bench._resolvelib_peer import resolve_with_resolvelib
from bench.tables import at, print_table
from uoarm._adapt import check_edge
from uoarm._resolve import Resolver, Structures
from uoarm.model import (
    Component,
    Endpoint,
    Function,
    Input,
    MessageStructure,
    Output,
    PortRef,
    Robot,
    Role,
)

FUNCTIONS = 10_000
LENGTHS = (3, 10, 100, 1_000)
BOX = MessageStructure(
    {
        "type": "object",
        "properties": {"x": {"type": "integer", "minimum": 0, "maximum": 640}},
        "required": ["x"],
        "additionalProperties": False,
    }
)


class Known:
    """Structures that are known already, so that no bridge is measured."""

    _all = Structures({"input.default": BOX, "output.default": BOX})

    def structures(self, component: Component) -> Structures:
        """Return the same structures for every component."""
        del component
        return self._all


def main() -> None:
    """Print the table."""
    robot = _robot()
    rows = [_measure(robot, length) for length in LENGTHS]
    head = ("chain of", "ours, new", "ours, again", "resolvelib")
    print_table("Resolving, milliseconds: median (p99)", head, rows)
    print(f"\nAmong {FUNCTIONS:,} functions of two candidates; every edge is checked.")


def _measure(robot: Robot, length: int) -> tuple[str, ...]:
    start, repeat = f"f{FUNCTIONS - length}", max(5, 2000 // length)
    ours = _milliseconds(lambda: Resolver(robot, Known(), check_edge).resolve(start), repeat)
    resolver = Resolver(robot, Known(), check_edge)
    resolver.resolve(start)
    warm = _milliseconds(lambda: resolver.resolve(start), repeat)
    peer = _milliseconds(
        lambda: resolve_with_resolvelib(robot, Known(), check_edge, start), max(1, 300 // length)
    )
    return f"{length:,}", _row(ours), _row(warm), _row(peer)


def _robot() -> Robot:
    functions = {}
    for number in range(FUNCTIONS):
        name = f"f{number}"
        needs = f"f{number + 1}" if number < FUNCTIONS - 1 else None
        functions[name] = Function(name, tuple(_component(name, n, needs) for n in range(2)))
    return Robot({}, functions)


def _component(function: str, number: int, needs: str | None) -> Component:
    name = f"{function}_{number}"
    inputs: tuple[Input, ...] = ()
    if needs is not None:
        inputs = (Input("default", Endpoint("b", name, Role.INPUT, (name,)), PortRef(needs)),)
    output = Output("default", Endpoint("b", name, Role.OUTPUT, (name,)))
    return Component(name, function, "b", -number, inputs, (output,))


def _milliseconds(action: Callable[[], object], repeat: int) -> list[float]:
    samples = []
    for _ in range(repeat):
        start = time.perf_counter_ns()
        action()
        samples.append((time.perf_counter_ns() - start) / 1e6)
    return sorted(samples)


def _row(samples: list[float]) -> str:
    return f"{at(samples, 0.5):,.3f} ({at(samples, 0.99):,.3f})"


if __name__ == "__main__":
    main()
