"""What bridges see now, as Discover lists it, and the configuration with one of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from uoarm._checks import bridge_facts
from uoarm.config import loads, merge, suggest
from uoarm.errors import UsageError
from uoarm.model import FoundComponent, Robot
from uoarm.server.streams import FeedRegistry

_ASK_SECONDS = 10.0
_GRACE_SECONDS = 1.0
_MOST_COMPONENTS = 1_000
_MOST_PORTS = 50


class Discoveries:
    """Asks bridges for a client; what takes long runs in a worker."""

    def __init__(self, registry: FeedRegistry) -> None:
        self._robot = registry.robot
        self._workers = registry.workers
        self._facts: Mapping[str, Mapping[str, str]] = {}

    async def look(self) -> list[dict[str, Any]]:
        """Return each bridge with what it sees, and each plugin that no bridge is of.

        Of one bridge a thousand components are listed, of each of them fifty ports, and how many
        more there are. A bridge that has not answered within a second is listed as before.

        Raises:
            UoarmError: the manager is closed, or BusyError.
        """
        return await self._workers.start(lambda: list(self._reports()))

    async def take(self, bridge: str, component: str) -> dict[str, Any]:
        """Return the configuration in force with a function for a component, as text.

        Raises:
            UsageError: it is not seen, is configured already, or there is no text to add it to.
            ConfigurationError: the lines cannot be added by themselves.
        """
        return await self._workers.start(lambda: self._with(bridge, component))

    def _reports(self) -> Iterator[dict[str, Any]]:
        robot = self._robot
        findings = robot.discover(timeout=_ASK_SECONDS, grace=_GRACE_SECONDS)
        used = {finding.plugin for finding in findings}
        if not used <= self._facts.keys():  # those of others would load what is not used
            self._facts = bridge_facts(robot.registry, used)
        for finding in findings:
            yield {
                "bridge": finding.bridge,
                "plugin": finding.plugin,
                "configured": True,
                "cause": finding.cause,
                "facts": self._facts.get(finding.plugin, {}),
                "components": [
                    _component(component) for component in finding.components[:_MOST_COMPONENTS]
                ],
                "more": max(0, len(finding.components) - _MOST_COMPONENTS),
                "left_out": finding.left_out,
            }
        for name in sorted({*robot.registry.types} - used):
            yield {
                "bridge": "",
                "plugin": name,
                "configured": False,
                "cause": "no bridge of the configuration is of this plugin",
                "facts": {},
                "components": [],
                "more": 0,
                "left_out": 0,
            }

    def _with(self, bridge: str, component: str) -> dict[str, Any]:
        text = self._robot.config.text
        if not text:
            raise UsageError("the configuration in force has no text that lines could be added to")
        findings = self._robot.discover(timeout=_ASK_SECONDS, grace=_GRACE_SECONDS)
        base: Robot = loads(text, self._robot.config.origin)
        lines = suggest(base, findings, configured=base.bridges, only=(bridge, component))
        merged = merge(text, lines)
        if merged == text:
            raise UsageError(
                f"{component!r:.200} of {bridge!r} is not seen now, or is in the configuration"
            )
        return {"text": merged, "lines": lines}


def _component(one: FoundComponent) -> dict[str, Any]:
    return {
        "name": one.name,
        "detail": one.detail,
        "ports": [
            {
                "role": port.endpoint.role.value,
                "port": port.endpoint.port,
                "address": list(port.endpoint.address),
                "known": port.message is not None or port.request is not None,
                "used_by": list(port.used_by),
                "rate": port.rate,
                "measured": port.is_measured,
            }
            for port in one.ports[:_MOST_PORTS]
        ],
        "more": max(0, len(one.ports) - _MOST_PORTS),
    }
