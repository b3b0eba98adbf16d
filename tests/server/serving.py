"""Servers on loopback before a robot, as many as a test starts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from uoarm import RobotManager
from uoarm.server import Limits, Server, ServerOptions, hash_token, serve_in_thread
from uoarm.server.front_end import FrontEnd


@contextmanager
def servers(robot: RobotManager, **always: Any) -> Iterator[Callable[..., Server]]:
    """Start servers and end them all; settings and limits by name."""
    with ExitStack() as stack:

        def start(
            limits: Limits | None = None,
            front_ends: Sequence[FrontEnd] | None = None,
            **settings: Any,
        ) -> Server:
            chosen = ServerOptions(port=0, limits=limits or Limits(), **always, **settings)
            return stack.enter_context(serve_in_thread(robot, chosen, front_ends=front_ends))

        yield start


def access_file(folder: Path, text: str, tokens: Mapping[str, str]) -> Path:
    """Write an access file; in its text, `{name}` stands for the hash of the token so named."""
    path = folder / "access.yaml"
    hashes = {name: hash_token(token) for name, token in tokens.items()}
    path.write_text(text.format(**hashes), encoding="utf-8")
    return path


def url(server: Server, path: str = "/") -> str:
    return f"ws://127.0.0.1:{server.ports[0]}{path}"
