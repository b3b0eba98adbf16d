"""How slowly wrong tokens are answered: ever more so, while right ones never wait."""

from __future__ import annotations

import ipaddress
from collections import Counter, OrderedDict

from attrs import define

__all__ = ["WrongTokens"]

_FREE, _FREE_IN_ALL = 5, 50
_FIRST_SECONDS = 0.1
_FORGIVEN_SECONDS = 10.0
_ADDRESSES = 4096
_NETWORK_BITS = 64


@define
class _Guesses:
    """How many wrong tokens came lately: one less after each ten seconds."""

    count: float = 0.0
    at: float = 0.0

    def add(self, now: float) -> float:
        self.count = max(0.0, self.count - max(0.0, now - self.at) / _FORGIVEN_SECONDS) + 1
        self.at = now
        return self.count


class WrongTokens:
    """Says how long a client that shows a wrong token waits for its answer. No clock, no waiting.

    The pause doubles with each wrong token of an address, and with those of all addresses together
    beyond a number that honest clients with an old token come to. Nothing here is asked about a
    right token: who has one is let in at once, from the same address, too. So that those who wait
    do not take all connections, only some may; the others get no answer.

    Args:
        longest: seconds for which a client waits at most.
        waiting: clients that may wait for their answer at one time; of one address an eighth.
    """

    def __init__(self, longest: float, waiting: int = 64) -> None:
        self._longest = longest
        self._most = waiting
        self._most_of_one = max(1, waiting // 8)
        self._of: OrderedDict[str, _Guesses] = OrderedDict()
        self._all = _Guesses()
        self._waiting: Counter[str] = Counter()

    def begin(self, address: str, now: float) -> float | None:
        """Count a wrong token; return the seconds until its answer, None for no answer at all.

        Where it waits, `end` follows.
        """
        network = _network(address)
        guesses = self._of.setdefault(network, _Guesses())
        self._of.move_to_end(network)
        if len(self._of) > _ADDRESSES:
            self._of.popitem(last=False)
        of_all = self._all.add(now)
        beyond = max(guesses.add(now) - _FREE, of_all - _FREE_IN_ALL)
        pause = 0.0 if beyond <= 0 else _FIRST_SECONDS * 2 ** min(beyond - 1, 30)
        if self._waiting[network] >= self._most_of_one or self._waiting.total() >= self._most:
            return None
        self._waiting[network] += 1
        return min(self._longest, pause)

    def end(self, address: str) -> None:
        """Note that a client waits no more."""
        self._waiting -= Counter({_network(address): 1})


def _network(address: str) -> str:
    """Return what counts as one address: of IPv6 a network, of which a guesser has all."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv4Address):
        return str(found)
    if found.ipv4_mapped is not None:
        return str(found.ipv4_mapped)
    return str(ipaddress.ip_network((found, _NETWORK_BITS), strict=False))
