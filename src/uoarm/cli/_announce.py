"""`uoarm serve --announce`: the served manager in the list of what is on the network.

By DNS-SD over multicast DNS (RFC 6763 and 6762), which everything on the network can read, and
anything there can imitate: what is announced is no secret, and proves nothing.
"""

from __future__ import annotations

import ipaddress
import socket
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING

from typing_extensions import Self

from uoarm._raised import reason_of
from uoarm.cli._output import echo
from uoarm.cli._shared import needing, print_warning
from uoarm.errors import ConfigurationError

if TYPE_CHECKING:
    from zeroconf import ServiceInfo

    from uoarm.server import ServerOptions

SERVICE = "_uoarm._tcp.local."
_HOST_LETTERS = 40  # of the 63 octets of a name
_END_SECONDS = 5.0


class Announcement:
    """Announces one served manager from `start` until it is left as a context.

    Announced are the machine's name, its addresses, the port, the manager's identity, whether TLS
    is spoken, and the version of the protocol.

    Args:
        interfaces: addresses of interfaces to announce on; None: those that the server listens on.

    Raises:
        ConfigurationError: only this machine can reach the server.
        PluginError: the extra `zeroconf` is not installed.
    """

    def __init__(
        self, identity: str, settings: ServerOptions, interfaces: Sequence[str] | None = None
    ) -> None:
        with needing("zeroconf"):
            import ifaddr  # noqa: F401, PLC0415 - an extra; here only whether it is there
            import zeroconf  # noqa: F401, PLC0415 - as above
        if settings.local and interfaces is None:
            raise ConfigurationError(
                f"{settings.host} can be reached from this machine only, so there is nothing to "
                "announce: give --host as well, or leave --announce out"
            )
        self._identity = identity
        self._settings = settings
        self._interfaces = interfaces
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Withdraw it; takes 5 s at most."""
        self._over.set()
        if self._thread is not None:
            self._thread.join(_END_SECONDS)

    def start(self, port: int) -> None:
        """Announce that the server listens on a port, in a thread of its own. Does not block.

        What keeps it from being announced is a warning: the server does without.
        """
        thread = threading.Thread(
            target=self._run, args=(port,), name="uoarm-announce", daemon=True
        )
        try:
            thread.start()
        except RuntimeError as error:  # the system gives no more threads
            print_warning(f"not announced: {error}")
        else:
            self._thread = thread

    def _run(self, port: int) -> None:
        from zeroconf import Zeroconf  # noqa: PLC0415 - of an extra

        try:
            addresses = list(self._interfaces or _addresses(self._settings))
            if not addresses:
                print_warning("not announced: this machine has no address on a network")
                return
            with Zeroconf(interfaces=addresses) as network:  # its end withdraws what is announced
                info = self._info(port, addresses)
                network.register_service(info)
                echo(f"announced on the network as {info.get_name()}", err=True)
                self._over.wait()
        except Exception as error:  # noqa: BLE001 - sockets and a library: the server does without
            print_warning(f"not announced: {reason_of(error)}")

    def _info(self, port: int, addresses: list[str]) -> ServiceInfo:
        from zeroconf import ServiceInfo  # noqa: PLC0415 - of an extra

        from uoarm._wire import TEXT_FORM  # noqa: PLC0415 - an extra, and slow

        machine = socket.gethostname().partition(".")[0][:_HOST_LETTERS]
        return ServiceInfo(
            SERVICE,
            f"{machine}-{self._identity[:8]}.{SERVICE}",
            port=port,
            parsed_addresses=addresses,
            # A name of its own: the machine's may be announced with other addresses by others.
            server=f"uoarm-{self._identity}.local.",
            properties={
                "id": self._identity,
                "protocol": TEXT_FORM.subprotocol.split(".")[1],
                "tls": "1" if self._settings.secured else "0",
            },
        )


def _addresses(settings: ServerOptions) -> list[str]:
    """Return the addresses that others reach the server at; looks up a name of its host."""
    import ifaddr  # noqa: PLC0415 - of an extra

    if settings.everywhere:
        found = [
            ip.ip if isinstance(ip.ip, str) else ip.ip[0]
            for adapter in ifaddr.get_adapters()
            for ip in adapter.ips
            if ip.is_IPv4 or ":" in settings.host
        ]
    else:
        places = socket.getaddrinfo(settings.host, None, type=socket.SOCK_STREAM)
        found = [str(place[4][0]) for place in places]
    return [text for text in dict.fromkeys(found) if _is_reachable(text)]


def _is_reachable(text: str) -> bool:
    address = ipaddress.ip_address(text.partition("%")[0])
    # One of IPv6 that holds on one link only cannot stand in a URL.
    is_of_one_link = isinstance(address, ipaddress.IPv6Address) and address.is_link_local
    return not (address.is_loopback or is_of_one_link)
