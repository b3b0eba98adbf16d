"""Maps with an order: a persistent one, of which a change makes another, and bounded ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TypeVar

from rpds import HashTrieMap

Key = TypeVar("Key")
Value = TypeVar("Value")

# Names of discovered components come and go for ever: what is kept by name needs a bound.
_NAMES = 1000


class OrderedMap(Mapping[Key, Value]):
    """A map in the order in which keys came; a change returns another map, in constant time.

    `rpds.HashTrieMap`, of which it consists, has no order. Where `step` needs one, it must be the
    same in each process, or a log would not replay.

    Args:
        items: to begin with.
    """

    __slots__ = ("_entries", "_first", "_keys", "_next")

    def __init__(self, items: Iterable[tuple[Key, Value]] = ()) -> None:
        values = dict(items)
        self._entries: HashTrieMap[Key, tuple[int, Value]] = HashTrieMap(
            {key: (place, value) for place, (key, value) in enumerate(values.items())}
        )
        self._keys: HashTrieMap[int, Key] = HashTrieMap(enumerate(values))
        # The oldest stands at the first place, and is found without a search.
        self._first = 0
        self._next = len(values)

    def insert(self, key: Key, value: Value) -> OrderedMap[Key, Value]:
        """Return the map with a value; a key that was there keeps its place, another is last."""
        entry = self._entries.get(key)
        if entry is not None:
            entries = self._entries.insert(key, (entry[0], value))
            return self._with(entries, self._keys, self._first, self._next)
        entries = self._entries.insert(key, (self._next, value))
        keys = self._keys.insert(self._next, key)
        return self._with(entries, keys, self._first, self._next + 1)

    def insert_last(self, key: Key, value: Value) -> OrderedMap[Key, Value]:
        """Return the map with a value, whose key is the last one now."""
        return self.discard(key).insert(key, value)

    def discard(self, key: Key) -> OrderedMap[Key, Value]:
        """Return the map without a key, if it has it."""
        entry = self._entries.get(key)
        if entry is None:
            return self
        # Each place is passed once, so that taking the oldest costs the same on average.
        keys, first = self._keys.remove(entry[0]), self._first
        while first < self._next and first not in keys:
            first += 1
        return self._with(self._entries.remove(key), keys, first, self._next)

    def place(self, key: Key) -> int:
        """Return by which number a key stands in the order."""
        return self._entries[key][0]

    def first(self) -> Key:
        """Return the key that came first of those that are there.

        Raises:
            KeyError: there is none.
        """
        return self._keys[self._first]

    def _with(
        self,
        entries: HashTrieMap[Key, tuple[int, Value]],
        keys: HashTrieMap[int, Key],
        first: int,
        following: int,
    ) -> OrderedMap[Key, Value]:
        made: OrderedMap[Key, Value] = OrderedMap.__new__(OrderedMap)
        made._entries, made._keys, made._first, made._next = entries, keys, first, following
        return made

    def __getitem__(self, key: Key) -> Value:
        return self._entries[key][1]

    def __contains__(self, key: object) -> bool:
        return key in self._entries

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[Key]:
        return (key for _, key in sorted(self._keys.items()))

    def __repr__(self) -> str:
        return f"OrderedMap({list(self.items())})"


def keep_newest(by_name: dict[str, Value], name: str, value: Value, most: int = _NAMES) -> None:
    """Set a value, and forget those that were set longest ago: names come and go for ever."""
    by_name.pop(name, None)
    by_name[name] = value
    while len(by_name) > most:
        del by_name[next(iter(by_name))]
