"""Who was seen how often, and whether that is right."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from attrs import define, field
from uoarm_vision.messages import People

__all__ = ["Tally"]

_ENOUGH = 0.5


@define
class Tally:
    """Counts of what was recognised, beside what should have been.

    Attributes:
        expected: source of pictures to the person that it shows, None for a stranger.
        frames: pictures by source.
        seen: pictures by source and by the name given there, None for "unknown".
    """

    expected: Mapping[str, str | None]
    frames: Counter[str] = field(factory=Counter)
    seen: dict[str, Counter[str | None]] = field(factory=dict)

    def add(self, message: People) -> list[str]:
        """Count one message; return the names that are new, each once."""
        source = message["frame"]["source"]
        before = self.names()
        names = {person["name"] for person in message["persons"]}
        self.frames[source] += 1
        self.seen.setdefault(source, Counter()).update(names)
        return sorted(name for name in names if name is not None and not before[name])

    def names(self) -> Counter[str | None]:
        """Return in how many pictures each name was given; None stands for "unknown"."""
        total: Counter[str | None] = Counter()
        for counted in self.seen.values():
            total.update(counted)
        return total

    def mistakes(self) -> int:
        """Return in how many pictures one person was taken for another."""
        return sum(
            times
            for source, counted in self.seen.items()
            for name, times in counted.items()
            if name is not None and name != self.expected[source]
        )

    def missed(self) -> list[str]:
        """Return whom the recogniser failed to name in half of the pictures that show them."""
        return sorted(
            person
            for source, person in self.expected.items()
            if person is not None
            and self.seen.get(source, Counter())[person] <= _ENOUGH * self.frames[source]
        )

    def strangers_known(self) -> bool:
        """Say whether every source that shows a stranger was called "unknown" at least once."""
        return all(
            self.seen.get(source, Counter())[None]
            for source, person in self.expected.items()
            if person is None
        )
