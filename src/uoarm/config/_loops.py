"""Feedback loops through topics: what a robot sends to one and takes from it again, without end.

A dependency cycle between functions is a mistake of its own; here at least one step leads through
a topic of a framework, which the functions do not show.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from typing import TypeAlias

from attrs import frozen

from uoarm._yaml import Path
from uoarm.config._parts import ComponentPart, PortPart

__all__ = ["SharedTopic", "feedback_loops"]

_MOST_EDGES = 200_000
_MOST_LOOPS = 20


@frozen
class SharedTopic:
    """Where whatever is sent is received by everybody who listens there.

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
    topic of one bridge, is none. Of a file with more than 200,000 edges nothing is told.
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
