"""Limits after which two ends take each other for gone, or what is under way is given up.

Those are for networks, for frameworks that hang and for hostile structures. In tests both ends are
here, structures are small, and what is late is only starved; a test about being late states its
limit.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from operator import attrgetter
from types import ModuleType
from typing import Any

_LIMITS: dict[str, dict[str, tuple[str, ...]]] = {
    "uoarm._adapt._edge": {"check_edge": ("seconds", "suggest_seconds")},
    "uoarm._host.process_connection": {"HostSettings": ("silence", "start")},
    "uoarm._host.transport.zenoh_transport": {"ZenohTransport": ("timeout", "lease")},
    "uoarm.client": {
        "connect": ("timeout",),
        "trust_fingerprint": ("timeout",),
        "RemoteRobot.call": ("timeout",),
    },
    "uoarm.local._bridge": {"PythonOptions": ("timeout",)},
    "uoarm.server": {
        "Limits": (
            "handshake_seconds",
            "queue_seconds",
            "stall_seconds",
            "request_seconds",
            "call_seconds",
        )
    },
    "uoarm_ros1._master": {"call_api": ("seconds",)},
    "websockets.asyncio.client": {"connect": ("open_timeout", "ping_timeout")},
    "websockets.sync.client": {"connect": ("open_timeout", "ping_timeout")},
}
# Of what is called without a limit.
_CONSTANTS = {
    "uoarm._bridges._bridge_set": ("_START_SECONDS",),
    "uoarm._control.candidates": ("_ASK_SECONDS", "_GRACE_SECONDS"),
    "uoarm._parts._application_ports": ("_LAST_SECONDS",),
    "uoarm._parts._component": ("_STOP_SECONDS",),
    "uoarm._parts._offered_function": ("_OPEN_SECONDS", "_DESCRIBE_SECONDS"),
    "uoarm._hints.applications": ("_SECONDS",),
    "uoarm._host.remote_bridge": ("_BLOCKING_SECONDS", "_PROMPT_SECONDS"),
    "uoarm._host.transport.socket_transport": ("_FULL_SECONDS", "_MUST_ARRIVE_SECONDS"),
    "uoarm._host.transport.zenoh_transport": ("_FULL_SECONDS",),
    "uoarm._host.xmlrpc_server": ("_DESCRIBE_SECONDS", "_REQUEST_SECONDS", "_CONNECTION_SECONDS"),
    "uoarm._renewal": ("_LAST_SECONDS",),
    "uoarm._resolve._catalogue": ("_DESCRIBE_SECONDS",),
    "uoarm._resolve._proofs": ("_PAIR_SECONDS", "_ROUND_SECONDS", "_SUGGEST_SECONDS"),
    "uoarm._resolve._search": ("_CHECK_SECONDS",),
    "uoarm.bridge._channel": ("_LAST_SECONDS",),
    "uoarm.bridge._watchdog": ("_LAST_SECONDS",),
    "uoarm.cli._show": ("_SECONDS",),
    "uoarm.config._plugins": ("_PARAMETER_SECONDS",),
    "uoarm.config._suggestion": ("_PAIR_SECONDS",),
    "uoarm.environments._environment": ("_SECONDS",),
    "uoarm.server._running": ("_START_SECONDS",),
    "uoarm.server.session._discoveries": ("_ASK_SECONDS", "_GRACE_SECONDS"),
    "uoarm.server.streams._known": ("_WAIT_SECONDS",),
    "uoarm_mqtt._link": ("_STEP_SECONDS", "_CONNECT_SECONDS", "_GOODBYE_SECONDS"),
    "uoarm_remote._link": ("_JOIN_SECONDS",),
    "uoarm_rocos._bridge": ("_OPEN_SECONDS",),
    "uoarm_rocos._line": ("_OPEN_SECONDS",),
    "uoarm_rocos._profile": ("_CATALOGUE_SECONDS",),
    "uoarm_ros1._discovery": ("_HEADER_SECONDS",),
    "uoarm_ros1._node": ("_ASK_SECONDS",),
    "uoarm_ros1._server": ("_ARRIVAL_SECONDS",),
    "uoarm_ros1._services": ("_PROBE_SECONDS",),
    "uoarm_ros1._subscription": ("_CONNECT_SECONDS", "_LISTED_SECONDS"),
    "uoarm_rosbridge.client._connection": ("_STEP_SECONDS", "_CONNECT_SECONDS"),
    "uoarm_rtm._compiler": ("_LIMIT_SECONDS",),
    "uoarm_rtm.nameserver": ("_START_SECONDS", "_STOP_SECONDS"),
    "uoarm_rtm._orb": ("_DRAIN_SECONDS", "_DESTROY_SECONDS", "_WORKERS_SECONDS"),
}


_WORKERS = "uoarm._support.workers"
# A worker thread of what a fixture of several tests holds waits that long for the next call: the
# check of what a test left behind waits for its end.
_IDLE_SECONDS = 0.1

LIMITED = frozenset({_WORKERS, *_CONSTANTS, *_LIMITS})
"""The modules that have such limits."""


class LongLimits:
    """Lengthens the limits that are never stated, of what is imported and of what will be.

    Much is imported by the first call that needs it, long after tests are collected. It is a finder
    of `sys.meta_path`.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def install(self) -> None:
        """Begin, with what is imported already."""
        for name in LIMITED:
            if (module := sys.modules.get(name)) is not None:
                self._lengthen(module)
        sys.meta_path.insert(0, self)

    def remove(self) -> None:
        """Leave what is imported from now on alone."""
        sys.meta_path.remove(self)

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Have a module of the tables lengthened once it has been run."""
        if name not in LIMITED:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and (loader := spec.loader) is not None:
            run = loader.exec_module

            def run_and_lengthen(module: ModuleType) -> None:
                run(module)
                self._lengthen(module)

            # Not a loader around it: resources and sources are asked of this one by its type.
            loader.exec_module = run_and_lengthen  # type: ignore[method-assign]
        return spec

    def _lengthen(self, module: ModuleType) -> None:
        if module.__name__ == _WORKERS:
            _set_default(module.WorkerPool.__init__, "idle_seconds", _IDLE_SECONDS)
        for constant in _CONSTANTS.get(module.__name__, ()):
            assert isinstance(getattr(module, constant), float)
            setattr(module, constant, self._seconds)
        for name, limits in _LIMITS.get(module.__name__, {}).items():
            called = inspect.unwrap(attrgetter(name)(module))
            for limit in limits:
                function = called.__init__ if inspect.isclass(called) else called
                _set_default(function, limit, self._seconds)


def _set_default(function: Callable[..., Any], name: str, value: float) -> None:
    """Change the default of one parameter."""
    function = inspect.unwrap(function)
    parameters = inspect.signature(function).parameters.values()
    by_name = function.__kwdefaults__ or {}
    if name in by_name:
        by_name[name] = value
        return
    by_place = [
        parameter.name for parameter in parameters if parameter.default is not parameter.empty
    ]
    defaults = dict(zip(by_place, function.__defaults__ or (), strict=False))
    assert name in defaults, f"{function.__qualname__} has no {name} by default"
    function.__defaults__ = (*(defaults | {name: value}).values(),)
