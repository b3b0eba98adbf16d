"""One end of a topic: a publisher or subscription whose policies are kept fitting its peers."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from attrs import frozen

from uoarm.bridge import Channel, ChannelMonitor, HealthReason, on_failure
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health
from uoarm_ros2._diagnostics import DiagnosticsReader, EntryLease
from uoarm_ros2._discovery import Ros2Graph, Topic
from uoarm_ros2._health import PROMISED, Report, monitored, promised_silence
from uoarm_ros2._middleware import UNNAMED, NodeRunner, Peer
from uoarm_ros2._options import Ros2Options
from uoarm_ros2._qos import Policies, QosOptions

_CLASH_TICKS = 5
_NAME_SECONDS = 0.5
_CLASH_SECONDS = 0.5  # within which a peer that has just started reaches the graph
Events = dict[str, Callable[[Any], None]]


@frozen
class TopicContext:
    """Everything that one topic channel stands on."""

    runner: NodeRunner
    graph: Ros2Graph
    endpoint: Endpoint
    topic: Topic
    native: type
    options: Ros2Options
    qos: QosOptions
    settle: float
    report: Report
    diagnostics: DiagnosticsReader
    clock: Callable[[], float] = time.monotonic

    def entry(self) -> EntryLease | None:
        """Return the entry that the options name, read until it is closed; None: they name none.

        Raises:
            BridgeError: diagnostics cannot be read.
        """
        name = self.options.diagnostics
        return self.diagnostics.watch(name, self.endpoint.component) if name else None

    def health(self, channel: Channel, *, receives: bool = False) -> ChannelMonitor:
        """Return what judges a channel here; `receives`: whether messages come in by it."""
        without_peers = Health.LOST if self.options.peer_required else Health.DEGRADED
        return monitored(
            f"topic {self.topic.name}",
            channel,
            self.report,
            without_peers=Health.OK if self.endpoint.is_offered else without_peers,
            stale_after=self.options.stale_after if receives else None,
            learns=receives,
            clock=self.clock,
        )


def judge_by_entry(health: ChannelMonitor, entry: EntryLease) -> None:
    """Have a channel judged by what its peer says of itself on `/diagnostics`."""
    verdict = entry.verdict()
    if verdict is not None:
        health.peer_reported(*verdict, about=entry.name)


class TopicEndpoint(ABC):
    """A native endpoint, made anew with other policies when all peers that are left ask for such.

    Must implement: the steps below that differ between reading and writing. Everything but
    `close` happens in the opening thread, then in the runner's.

    Args:
        receives: whether publishers are the peers, whose deadlines promise messages.

    Attributes:
        policies: in force.
        native: rclpy's end.
        departures: how often peers have gone.
    """

    peer_word: str

    def __init__(
        self, context: TopicContext, health: ChannelMonitor, *, receives: bool = False
    ) -> None:
        self._context = context
        self._health = health
        self._keeps_deadlines = receives and context.options.stale_after is None
        self._note = ""
        self._lost = self._incompatible = self._deadlines_missed = 0
        self._clash_checks = 0
        self._clashes_since = math.inf
        self._clashing = False
        self._peers_changed = False
        self._is_differing = False
        self._has_other_types = False
        self._unreached = ""
        self._closed = False  # set by any thread; a tick under way may still report
        self.departures = 0
        self.policies = self._fitting(self.peers())
        self._entry = context.entry()
        with on_failure(self._release_entry):
            self.native = self._create()

    @abstractmethod
    def graph_peers(self, topic: str) -> tuple[Peer, ...]:
        """Return the peers of a topic on the graph, of any type."""

    @abstractmethod
    def count(self) -> int:
        """Return how many peers are matched now."""

    @abstractmethod
    def clashes_with(self, peer: Policies) -> tuple[str, ...]:
        """Name the policies on which this end and a peer cannot meet."""

    @abstractmethod
    def comparison(self, peer: Peer) -> str:
        """Return the sentence that sets the policies of both sides side by side."""

    @abstractmethod
    def _fitting(self, peers: Iterable[Peer]) -> Policies:
        """Return the policies that the settings and the peers of our type call for."""

    @abstractmethod
    def _create(self) -> Any:
        """Create the native endpoint with the policies of now."""

    def peers(self) -> list[Peer]:
        """Return the peers of our type that are on the graph, matched or not."""
        topic = self._context.topic
        return [peer for peer in self.graph_peers(topic.name) if peer.type == topic.type]

    def cannot_match(self) -> bool:
        """Whether all peers on the graph have clashed for so long that waiting will not help."""
        peers = self.peers()
        if not peers or not all(self.clashes_with(peer.policies) for peer in peers):
            self._clashes_since = math.inf
            return False
        now = time.monotonic()
        self._clashes_since = min(self._clashes_since, now)
        return now - self._clashes_since > _CLASH_SECONDS

    def require(self, limit: float, peers: Sequence[Peer]) -> None:
        """Raise BridgeError when a required peer is not matched, or none has our definition.

        The text says what is in the way.

        Args:
            limit: for how many seconds one was waited for.
            peers: those of our type that are on the graph now.
        """
        if not self._context.options.peer_required:
            return
        name = self._context.topic.name
        if self.count() == 0:
            text = f"no {self.peer_word} of {name} was matched within {limit:g} s"
            clashes = self._clashes()
            text = f"topic {name}: {clashes}" if clashes else text
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if self._all_differ(peers):
            self._context.graph.until(lambda: UNNAMED not in self._difference_text(), _NAME_SECONDS)
            text = f"topic {name}: {self._difference_text()}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def tick(self) -> None:
        """Look after the end a few times a second, in the runner's thread."""
        self._health.tick(self._note)
        if self._closed:
            return
        if self._entry is not None:
            judge_by_entry(self._health, self._entry)
        if self._clash_checks:
            self._clash_checks -= 1
            self._resolve_clash()
        elif self._clashing:
            self._check_clash_ended()
        if self._peers_changed:
            self._peers_changed = False
            peers = self.peers()
            self._check_definitions(peers)
            if self._keeps_deadlines:
                promised = promised_silence(peer.policies.deadline for peer in peers)
                self._note = PROMISED if promised is not None else ""
                self._health.expect(promised)
            self._check_unreached(peers)
        if self._context.graph.has_other_types(self._context.topic) is not self._has_other_types:
            self._check_other_types()

    def facts(self) -> Mapping[str, object]:
        """Return counters, the matched peers and the policies in force."""
        return {
            **self._health.facts(),
            "matched": self._health.peers,
            "messages": self._health.messages,
            "lost_by_middleware": self._lost,
            "qos_clashes": self._incompatible,
            "deadlines_missed": self._deadlines_missed,
            "qos": str(self.policies),
            **(self._entry.facts() if self._entry is not None else {}),
        }

    def close(self) -> None:
        """Put the native endpoint away."""
        self._closed = True
        self._release_entry()
        self._context.runner.discard(self.native)

    def events(self) -> Events:
        """Return the callbacks that both kinds of end have."""
        common: Events = {
            "matched": lambda info: self._matched(info.current_count, info.current_count_change),
            "incompatible_qos": lambda info: self._note_clash(info.total_count),
        }
        if self.policies.deadline is not None:
            common["deadline"] = lambda info: self._note_missed_deadline(info.total_count)
        return common

    def _note_missed_deadline(self, total: int) -> None:
        self._deadlines_missed = total
        self._health.missed(f"the deadline passed {total} times without a message")

    def note_lost(self, total: int) -> None:
        """Note how many messages the middleware has lost since opening."""
        self._lost = total
        self._health.missed(f"{total} messages lost by the middleware since opening")

    def _release_entry(self) -> None:
        if self._entry is not None:
            self._entry.close()

    def _judge(self, about: str, problem: str, well: str, *, total: bool = False) -> None:
        """Report a problem that lasts, or its end; `total`: no peer is without it."""
        health = Health.OK
        if problem:
            is_lost = total and self._context.options.peer_required
            health = Health.LOST if is_lost else Health.DEGRADED
        self._health.judged(HealthReason.REFUSED, health, problem or well, about)

    def _matched(self, current: int, change: int) -> None:
        self._peers_changed = True
        self.departures += change < 0
        if not current:
            self._clash_checks = _CLASH_TICKS  # those that are left may be the ones that clash
        gone = "" if current else f"the last {self.peer_word} is gone"
        was_alone = not self._health.peers
        self._health.connected(current, gone)
        if was_alone or not current:
            # Whether all peers clash or only some is another loss.
            self._clash_checks = max(self._clash_checks, int(self._clashing))

    def _own_definition(self) -> str:
        context = self._context
        return context.runner.own_definition(context.topic.name, context.topic.type, context.native)

    def _differing_peers(self, peers: Iterable[Peer]) -> list[Peer]:
        """Return the peers whose type has our name and another definition: DDS matches by name."""
        own = self._own_definition()
        return [peer for peer in peers if own and peer.definition not in {"", own}]

    def _all_differ(self, peers: Sequence[Peer]) -> bool:
        return 0 < len(self._differing_peers(peers)) == len(peers)

    def _difference_text(self) -> str:
        topic = self._context.topic
        differing = self._differing_peers(self.peers())
        theirs = "; ".join(f"{peer.node} has {peer.definition}" for peer in differing)
        return (
            f"{topic.type} is defined otherwise there than here: {theirs}, this "
            f"process has {self._own_definition()}"
        )

    def _check_definitions(self, peers: Sequence[Peer]) -> None:
        before, self._is_differing = self._is_differing, bool(self._differing_peers(peers))
        if self._is_differing:
            text = self._difference_text()
            self._judge("definition", text, "", total=self._all_differ(peers))
            self._peers_changed = UNNAMED in text  # the graph learns of an end, then of its node
        elif before:
            self._judge("definition", "", "every peer has our definition of the type")

    def unreached(self, peers: Sequence[Peer]) -> str:
        """Say what of the peers is not reached although all fit; mostly empty."""
        del peers
        return ""

    def _check_unreached(self, peers: Sequence[Peer]) -> None:
        before, self._unreached = self._unreached, self.unreached(peers)
        if UNNAMED in self._unreached:
            self._unreached, self._peers_changed = before, True
        elif self._unreached and self._unreached != before:
            self._judge("reach", self._unreached, "")
        elif before and not self._unreached:
            self._judge("reach", "", "all that the peers offer is reached")

    def _check_other_types(self) -> None:
        """Report a node that uses another type on our topic, which ROS 2 itself does not."""
        topic = self._context.topic
        others = self._context.graph.other_types(topic)
        if UNNAMED in others:
            return  # its node reaches the graph a moment later
        self._has_other_types = bool(others)
        if others:
            self._judge("types", f"it carries other types than {topic.type} too: {others}", "")
        else:
            self._judge("types", "", f"it carries {topic.type} only")

    def _note_clash(self, total: int) -> None:
        """Take note of a peer that does not fit; in the runner's thread, as messages are."""
        self._incompatible = total
        self._clash_checks = _CLASH_TICKS
        self._resolve_clash()

    def _resolve_clash(self) -> None:
        """Adapt while no peer is matched that would lose by it, else report what clashes."""
        alone = self.count() == 0
        peers = self.peers()
        fitting = self._fitting(peers)
        if alone and peers and fitting != self.policies and not self._closed:
            before, self.policies = self.native, fitting
            self.native = self._create()
            self._context.runner.discard(before)
            self._clash_checks = 0
            return
        text = self._clashes()
        if self._clash_checks and (not text or UNNAMED in text):
            return  # the graph learns of a peer, then of its node, a moment after the event
        self._clash_checks = 0
        if text:
            self._clashing = True
            self._judge("qos", text, "", total=alone)

    def _check_clash_ended(self) -> None:
        """Report that the last peer that did not fit is gone."""
        if not self._clashes():
            self._clashing = False
            self._judge("qos", "", f"every {self.peer_word} fits")

    def _clashes(self) -> str:
        clashing = ((peer, self.clashes_with(peer.policies)) for peer in self.peers())
        sentences = [
            f"{self.comparison(peer)}: they clash on {'; '.join(found)}"
            for peer, found in clashing
            if found
        ]
        if not sentences:
            return ""
        return f"incompatible QoS: {' / '.join(sentences)}"
