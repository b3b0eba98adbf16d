"""What bridges see, whether the configuration names it or not."""

from __future__ import annotations

import json

from attrs import field, frozen

from uoarm.model._component import Endpoint
from uoarm.model._message import MessageStructure
from uoarm.model._wire import to_json

__all__ = ["BridgeFindings", "FoundComponent", "FoundPort"]

_ONCE = 40
"""Characters of a detail from which on it is said once, and another component refers to it."""


@frozen
class FoundPort:
    """A port that a bridge sees now.

    Attributes:
        endpoint: where it is, as the configuration would name it.
        message: its structure; None where the framework does not know, and for services.
        request: that of a service's request.
        reply: that of its reply.
        used_by: components of the configuration that have this endpoint.
        rate: messages a second that come out of it: as measured while the robot has it open, else
            as the framework states it; None where it is not known. Findings that differ in rates
            only are equal.
        is_measured: whether the rate was.
    """

    endpoint: Endpoint
    message: MessageStructure | None = None
    request: MessageStructure | None = None
    reply: MessageStructure | None = None
    used_by: tuple[str, ...] = ()
    rate: float | None = field(default=None, eq=False)
    is_measured: bool = field(default=False, eq=False)

    def __str__(self) -> str:
        end = self.endpoint
        text = f"{end.role.value:<7} {', '.join(end.address)}"
        if end.parameters:
            text += f"  {json.dumps(to_json(end.parameters))}"
        if self.message is None and self.request is None:
            text += "  (structure unknown)"
        if self.rate is not None:
            text += f"  {self.rate:.3g} a second" + ("" if self.is_measured else ", as stated")
        return text + (f"  used by {', '.join(self.used_by)}" if self.used_by else "")


@frozen
class FoundComponent:
    """A component that a bridge sees now.

    Attributes:
        name: as its framework names it.
        detail: what else the framework says of it.
    """

    name: str
    ports: tuple[FoundPort, ...]
    detail: str = ""


@frozen
class BridgeFindings:
    """What one bridge sees now.

    Attributes:
        bridge: its name.
        plugin: that made it.
        components: what it sees, by name.
        cause: why it sees nothing; empty where it does.
        left_out: ports beyond the limit, which are not among the components.

    As text (`str`, `print`) it is what `uoarm discover` shows.
    """

    bridge: str
    plugin: str
    components: tuple[FoundComponent, ...] = ()
    cause: str = ""
    left_out: int = 0

    def __str__(self) -> str:
        if self.cause:
            return f"{self.bridge}  {self.cause}"
        s = "" if len(self.components) == 1 else "s"
        lines = [f"{self.bridge}  {len(self.components)} component{s}"]
        said: dict[str, str] = {}
        for component in self.components:
            detail = component.detail
            if len(detail) > _ONCE and said.setdefault(detail, component.name) != component.name:
                detail = f"the same as {said[detail]}"
            lines.append(f"  {component.name}" + (f"  ({detail})" if detail else ""))
            lines += [f"    {port}" for port in component.ports]
        if self.left_out:
            lines.append(f"  and {self.left_out:,} ports more, beyond the limit")
        return "\n".join(lines)
