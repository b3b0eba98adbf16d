"""Feedback loops through topics: what a robot sends to one and takes from it again, without end.

A dependency cycle between functions is a mistake of its own; here at least one step leads through
a topic of a framework, which the functions do not show.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from typing import TypeAlias

from attrs import frozen

from uoarm._support.yaml import Path
from uoarm.config._parts import ComponentPart, PortPart

_MOST_EDGES = 200_000
_MOST_LOOPS = 20


@frozen
class SharedTopic:
    """Where whatever is sent is received by all subscribers.

    Attributes:
        framework: the plugin, and what keeps two of its bridges apart.
        name: for people.
    """

    framework: str
    name: str


Node: TypeAlias = "SharedTopic | int"
"""A topic, or the number of a component."""

TopicOf: TypeAlias = Callable[[ComponentPart, PortPart], "SharedTopic | None"]


def feedback_loops(
    components: list[ComponentPart], topic_of: TopicOf
) -> Iterator[tuple[Path, list[str]]]:
    """Yield loops: the component with which one begins, and the names along it.

    A topic that a framework connects by itself, an edge without `map` whose two ends are the same
    topic of one bridge, is none. Of a file with more than 200,000 edges nothing is reported.
    """
    before, feeds = _predecessors(components, topic_of)
    for _ in range(_MOST_LOOPS):
        try:
            TopologicalSorter(before).prepare()
        except CycleError as error:
            loop: list[Node] = error.args[1]
        else:
            return
        topics = [item for item in loop if isinstance(item, SharedTopic)]
        numbers = [item for item in loop if not isinstance(item, SharedTopic)]
        if topics:
            start = min(topics, key=lambda topic: topic.name)
            first = loop.index(start)
            names = [_name(components, item) for item in (*loop[first:-1], *loop[:first], start)]
            steps = (feeds.get(step) for step in pairwise(loop))
            fed = (number for number in steps if number is not None)
            yield components[numbers[0] if numbers else next(fed)].path, names
        gone = topics[0] if topics else loop[0]
        before = {name: left - {gone} for name, left in before.items() if name != gone}


def _predecessors(
    components: list[ComponentPart], topic_of: TopicOf
) -> tuple[dict[Node, set[Node]], dict[tuple[Node, Node], int]]:
    """Return for every node those whose messages it gets, and whose input a step leads into."""
    feeds: dict[tuple[Node, Node], int] = {}
    providers: dict[str, list[int]] = defaultdict(list)
    for number, component in enumerate(components):
        providers[component.function].append(number)
    before: dict[Node, set[Node]] = defaultdict(set)
    edges = 0
    for number, component in enumerate(components):
        for output in component.outputs():
            topic = topic_of(component, output)
            if topic is not None:
                before[topic].add(number)
        for port in component.inputs():
            topic = topic_of(component, port)
            into: Node = number if topic is None else topic
            if topic is not None:
                before[number].add(topic)
            function, _, name = (port.source or "").partition(".")
            for provider in providers[function] if function else ():
                for output in components[provider].outputs():
                    edges += 1
                    if edges > _MOST_EDGES:
                        return {}, {}
                    if output.name != (name or output.name):
                        continue
                    origin = topic_of(components[provider], output)
                    same = component.text("bridge") == components[provider].text("bridge")
                    if origin is None or origin != topic or not same or "map" in port.value:
                        start: Node = provider if origin is None else origin
                        before[into].add(start)
                        feeds.setdefault((start, into), number)
    return before, feeds


def _name(components: list[ComponentPart], node: Node) -> str:
    return node.name if isinstance(node, SharedTopic) else components[node].text("name") or "?"


Needs: TypeAlias = Mapping[str, Sequence[frozenset[str]]]
"""For every function, what each of its components depends on."""

Cycle: TypeAlias = "tuple[str, ...]"
"""Functions, each of which needs the next; the first again at the end."""


def unavoidable_cycles(needs: Needs) -> list[Cycle]:
    """Return one shortest cycle for every knot of functions that nothing can untie.

    A function can be grounded when one of its components needs only functions that can be. A
    knot is a set of functions that reach each other; one that could be untied as soon as another
    is mended is not reported.
    """
    stuck = needs.keys() - _groundable(needs)
    found: list[Cycle] = []
    for knot in _knots(_graph(needs, stuck)):
        inside = {need: [wanted & knot for wanted in needs[need]] for need in needs if need in knot}
        lost = inside.keys() - _groundable(inside)
        if lost:
            graph = _graph(inside, lost)
            found.append(_shortest_cycle(graph, next(_knots(graph))))
    return found


def avoidable_cycles(needs: Needs) -> list[Cycle]:
    """Return one shortest cycle for every knot that other components can avoid."""
    graph = _graph(needs, _groundable(needs))
    return [_shortest_cycle(graph, knot) for knot in _knots(graph)]


def _groundable(needs: Needs) -> set[str]:
    """The least fixpoint, in time linear in the size of the configuration."""
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
    return found


def _graph(needs: Needs, among: AbstractSet[str]) -> dict[str, list[str]]:
    """What each function needs by any of its components, in the order of the file."""
    order = {name: number for number, name in enumerate(needs)}
    return {
        need: sorted(set().union(*needs[need]) & among, key=order.__getitem__)
        for need in needs
        if need in among
    }


def _knots(graph: Mapping[str, Sequence[str]]) -> Iterator[frozenset[str]]:
    """Yield the sets of functions that reach each other; before a knot those that it reaches.

    Tarjan's algorithm with an explicit stack.
    """
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    open_: dict[str, None] = {}
    for root in graph:
        if root in number:
            continue
        work = [(root, iter(graph[root]))]
        number[root] = low[root] = len(number)
        open_[root] = None
        while work:
            node, rest = work[-1]
            for other in rest:
                if other not in number:
                    number[other] = low[other] = len(number)
                    open_[other] = None
                    work.append((other, iter(graph[other])))
                    break
                if other in open_:
                    low[node] = min(low[node], number[other])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == number[node]:
                    knot = _close(open_, node)
                    if len(knot) > 1 or node in graph[node]:
                        yield knot


def _close(open_: dict[str, None], root: str) -> frozenset[str]:
    members: set[str] = set()
    while root not in members:
        members.add(open_.popitem()[0])
    return frozenset(members)


def _shortest_cycle(graph: Mapping[str, Sequence[str]], knot: frozenset[str]) -> Cycle:
    """Return a shortest cycle through the knot's first function."""
    start = next(name for name in graph if name in knot)
    came_from: dict[str, str] = {}
    waiting = deque([start])
    while waiting:
        node = waiting.popleft()
        if start in graph[node]:
            return (*_way(came_from, start, node), start)
        for other in graph[node]:
            if other in knot and other not in came_from and other != start:
                came_from[other] = node
                waiting.append(other)
    raise AssertionError("every function of a knot lies on a cycle")


def _way(came_from: Mapping[str, str], start: str, end: str) -> Cycle:
    steps = [end]
    while steps[-1] != start:
        steps.append(came_from[steps[-1]])
    return tuple(reversed(steps))
