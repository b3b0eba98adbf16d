"""What a configuration may say of this bridge and of its endpoints, and what an address is."""

from __future__ import annotations

import re

from attrs import frozen

from uoarm.bridge import BridgeOptions, EndpointOptions, TlsOptions, address_check, host_of, option

_SECONDS = {"type": "number", "exclusiveMinimum": 0}
_FINGERPRINT = {
    "type": "string",
    "pattern": "^([0-9A-Fa-f]{2}:?){31}[0-9A-Fa-f]{2}$",
    "examples": [":".join(["73", "2E"] * 16)],
}
_URL = {"type": "string", "pattern": r"^wss?://[^@?#\s]+$", "examples": ["wss://robot3:9080/"]}
_FILE = {"type": "string", "minLength": 1, "x-uoarm-path": True}
_PARTS = 2  # a function and a port
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,127}")


@frozen
class ManagerOptions(BridgeOptions):
    """The options of a bridge: where the other manager is, and how it is reached."""

    url: str = option("", _URL, "of `uoarm serve` there", required=True)
    token_file: str | None = option(
        None, _FILE, "file that holds the token which is shown, and nothing else"
    )
    tls: TlsOptions | None = option(None, TlsOptions, "what is trusted and shown, with `wss`")
    fingerprint: str | None = option(
        None, _FINGERPRINT, "SHA-256 of its certificate, as `uoarm serve --tls auto` prints it"
    )
    discover: bool = option(
        False,
        {"type": "boolean"},
        "whether functions with `needs` may use what it exports",
    )
    timeout: float = option(5.0, _SECONDS, "seconds that an answer may take", unit="s")
    silence: float = option(
        3.0,
        _SECONDS,
        "seconds without a sign of life after which the link counts as broken",
        unit="s",
    )
    grace: float = option(
        10.0, _SECONDS, "seconds that the link may be broken before what is open is lost", unit="s"
    )

    def check_together(self) -> None:
        """Refuse what is no address, what goes with TLS only, and two kinds of trust at once."""
        host_of(self.url)
        secured = self.url.startswith("wss:")
        if not secured and (self.tls is not None or self.fingerprint is not None):
            raise ValueError("`tls` and `fingerprint` go with a `url` that begins with wss://")
        if self.tls is not None and self.fingerprint is not None:
            raise ValueError("say `tls` or `fingerprint`, not both")


@frozen
class FunctionOptions(EndpointOptions):
    """The options of one endpoint."""

    every: float = option(
        0.0, {"type": "number", "minimum": 0}, "seconds between two messages, at least", unit="s"
    )
    stale_after: float | None = option(
        None, _SECONDS, "seconds without a message after which an output is lost", unit="s"
    )
    backlog: int = option(
        1000,
        {"type": "integer", "minimum": 1, "maximum": 100_000},
        "messages that may wait",
    )
    backlog_bytes: int = option(
        67_108_864,
        {"type": "integer", "minimum": 1},
        "bytes that they may hold; the newest message is always kept",
    )


def check_address(address: tuple[str, ...]) -> None:
    """Raise ValueError for what is no address."""
    if not 1 <= len(address) <= _PARTS or not all(map(_NAME.fullmatch, address)):
        text = "expected the name of a function, and of one of its ports, got"
        raise ValueError(f"{text} {list(address)}")


mistake = address_check(check_address)
