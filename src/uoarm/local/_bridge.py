"""The `python` bridge: functions, generators and classes of Python as components."""

from __future__ import annotations

import inspect
import json
import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeAlias

from attrs import define, field, frozen

from uoarm._raised import LimitedLog, contained, foreign, sentence_of, text_of
from uoarm._support.workers import WorkerPool
from uoarm.bridge import (
    Bridge,
    BridgeOptions,
    BridgeType,
    Capabilities,
    Channel,
    Description,
    Discovered,
    EndpointOptions,
    ServiceStructures,
    Sink,
    Source,
    hookimpl,
    option,
)
from uoarm.errors import BridgeError
from uoarm.local._instance import Instance
from uoarm.local._loop import Coroutines, LoopThread
from uoarm.local._modules import Modules
from uoarm.local._target import Target, address_mistake, find, generates
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure, Options, Role

_LISTED = {
    "type": "array",
    "items": {
        "anyOf": [
            {"type": "string", "minLength": 1},
            {
                "type": "object",
                "required": ["component"],
                "properties": {
                    "component": {"type": "string", "minLength": 1},
                    "name": {"type": "string", "minLength": 1},
                    "parameters": {"type": "object"},
                },
                "additionalProperties": False,
            },
        ]
    },
}
_SOURCE_SECONDS = 0.25
_GLANCE_SECONDS = 0.005
_Key: TypeAlias = tuple[str, tuple[str, ...], str]


def listed(
    bridge: str, entries: Iterable[Any], find: Callable[[tuple[str, ...]], Target]
) -> Iterator[Discovered]:
    """Yield what discovery shows of each entry; one that cannot be used has its cause as detail.

    Args:
        bridge: the name of the instance.
        entries: of the option.
        find: imports what an address names; raises BridgeError.
    """
    for entry in entries:
        report: Mapping[str, Any] = entry if isinstance(entry, Mapping) else {"component": entry}
        address = (str(report["component"]),)
        name = str(report.get("name") or address[0].partition(":")[2] or address[0])
        parameters: Options = report.get("parameters", {})
        try:
            target = find(address)
            ends = [
                Endpoint(bridge, name, role, address, port, parameters=parameters)
                for role, port in _ports(target, parameters)
            ]
            ports = tuple((end, _described(target, end)) for end in ends)
        except BaseException as error:  # noqa: BLE001 - a module, or its hints, may raise anything
            yield Discovered(name, (), f"cannot be used: {sentence_of(contained(error))}")
            continue
        yield Discovered(name, ports, address[0])


def _ports(target: Target, parameters: Options) -> Iterator[tuple[Role, str]]:
    """Yield the ports that an object may be used with: as a stream, and as a service, if it can."""
    if not target.is_class:
        takes = target.first_unfilled(target.value, parameters) is not None
        if takes:
            yield Role.INPUT, "default"
            if not generates(target.value):
                yield Role.SERVICE, "default"
        yield Role.OUTPUT, "default"
        return
    if target.source_name() is not None:
        yield Role.OUTPUT, "default"
        return
    if target.own("__call__") is not None:
        yield from ((role, "default") for role in (Role.INPUT, Role.SERVICE, Role.OUTPUT))
        return
    for name, _ in inspect.getmembers(target.value, inspect.isfunction):
        if not name.startswith("_"):
            yield Role.INPUT, name


def _described(target: Target, end: Endpoint) -> Description:
    """Return the structures of a port; unknown ones where a hint has none."""
    try:
        return target.describe(end)
    except BridgeError:
        target.require_parameters(end.parameters)
        return Description()


@define(eq=False)
class _Slot:
    """One component's instance and how many open ports use it.

    Attributes:
        key: of the component.
        before: the instance that died, in whose place this one comes; it is closed first.
        building: held while the instance is built.
        users: open ports.
        instance: None until it is built.
    """

    key: _Key
    before: Instance | None = None
    building: threading.Lock = field(factory=threading.Lock)
    users: int = 0
    instance: Instance | None = None


@frozen
class PythonOptions(BridgeOptions):
    """Where Python objects are looked for, and what is said of them."""

    path: tuple[str, ...] = option(
        (),
        {"type": "array", "items": {"type": "string", "x-uoarm-path": True}},
        "folders in which modules are looked for first",
    )
    timeout: float = option(
        10.0,
        {"type": "number", "exclusiveMinimum": 0},
        "seconds that an `async def` handler may take for a message",
        unit="s",
    )
    code: str = option(
        "",
        {"type": "string", "pattern": "^[0-9a-f]{1,32}$"},
        "chosen by uoarm when the code is to be read again; not for files",
    )
    discover: tuple[str | Mapping[str, Any], ...] = option(
        (), _LISTED, "components that discovery shows: module:attribute, also with parameters"
    )


class PythonBridge(Bridge):
    """Runs plain Python objects as components, in threads of this process.

    An endpoint's address is one string, `module:attribute`. All endpoints of one component
    share one instance, made when the first channel opens and closed with the last; that of a
    service is made at its first call and closed with the bridge. One whose source raised is dead:
    the next channel closes it, though others of it are open, and gets a new one. What is
    asynchronous runs in one event loop of the bridge and is cancelled when its component closes.
    """

    capabilities = Capabilities(discover=True, call=True)

    def __init__(self, name: str, options: PythonOptions) -> None:
        super().__init__(name, options)
        self._modules = Modules(options.path, options.code)
        self._listing = options.discover
        self._targets: dict[tuple[str, ...], Target] = {}
        self._handler_seconds = options.timeout
        self._loop = LoopThread(f"uoarm-{name}-loop")
        self._slots: dict[_Key, _Slot] = {}
        self._services: set[_Slot] = set()
        self._workers = WorkerPool(f"uoarm-{name}-source")
        self._counting = threading.Lock()
        self._logs: dict[str, LimitedLog] = {}

    def _describe(self, endpoint: Endpoint) -> Description:
        return self._of_address(endpoint.address).describe(endpoint)

    def _discover(self) -> tuple[Discovered, ...]:
        return tuple(listed(self.name, self._listing, self._of_address))

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Source:
        del structure
        target = self._of_address(endpoint.address)
        port = target.port(endpoint)
        slot, instance = self._enter(endpoint, target)
        try:
            source = None if port.takes_messages else instance.source(port)
        except BaseException:
            self._leave(slot)
            raise

        def leave() -> None:
            if source is not None:
                source.remove_listener(channel)
            instance.remove_receiver(endpoint.port, channel)
            self._leave(slot)

        channel = Source(endpoint, leave)
        instance.add_receiver(endpoint.port, channel, deliver)
        if source is not None:
            try:
                source.add_listener(channel, lambda failure: self._ended(channel, failure))
            except BaseException:
                leave()
                raise
        return channel

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        slot, instance = self._enter(endpoint, self._of_address(endpoint.address))
        try:
            take = instance.feed(endpoint)
        except BaseException:
            self._leave(slot)
            raise
        return Sink(endpoint, take, lambda: self._leave(slot))

    def _is_quick(self, endpoint: Endpoint) -> bool:
        target = self._targets.get(endpoint.address)
        return target is not None and target.port(endpoint).is_quick

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures
        slot, instance = self._enter(endpoint, self._of_address(endpoint.address))
        with self._counting:
            # The first call's use lasts as long as the bridge, which may be closed by now.
            stays = not self.closed and slot not in self._services
            if stays:
                self._services.add(slot)
        try:
            return instance.answer(endpoint, message, timeout)
        finally:
            if not stays:
                self._leave(slot)

    def _close(self) -> None:
        """Wait a quarter of a second at most for sources that have a message under way.

        Every instance went with its last channel, those of services go now. A thread that is still
        in foreign code when the interpreter ends may take the whole process down with it.
        """
        failure: Exception | None = None
        with self._counting:
            services, self._services = self._services, set()
        for slot in services:
            try:
                foreign(self._leave, slot)
            except Exception as error:  # noqa: BLE001 - the others must be closed, too
                failure = failure or error
        self._workers.close(drop=False)
        deadline = time.monotonic() + _SOURCE_SECONDS
        pause = threading.Event()
        while self._workers.busy and time.monotonic() < deadline:
            pause.wait(_GLANCE_SECONDS)
        self._loop.close()
        self._modules.close()
        if failure is not None:
            raise failure

    def _of_address(self, address: tuple[str, ...]) -> Target:
        target = self._targets.get(address)
        if target is None:
            target = self._targets[address] = find(address, self._modules)
        return target

    def _enter(self, endpoint: Endpoint, target: Target) -> tuple[_Slot, Instance]:
        """Use the component's instance; one that is slow to build holds up no other."""
        key = _key(endpoint)
        with self._counting:
            slot = self._slots.get(key)
            before = None if slot is None else slot.instance
            if slot is None or (before is not None and before.is_dead):
                slot = self._slots[key] = _Slot(key, before)
            slot.users += 1
            if slot.instance is not None:  # it stays what it is
                return slot, slot.instance
        try:
            with slot.building:
                if slot.instance is None:
                    before, slot.before = slot.before, None
                    if before is not None:
                        self._close_dead(slot.key[0], before)
                    coroutines = Coroutines(self._loop, self._handler_seconds)
                    slot.instance = Instance(target, endpoint.parameters, coroutines, self._workers)
                return slot, slot.instance
        except BaseException:
            self._leave(slot)
            raise

    def _close_dead(self, component: str, instance: Instance) -> None:
        """Have what died let go of what it holds, which the instance in its place may need."""
        try:
            foreign(instance.close)
        except Exception as error:  # noqa: BLE001 - it is dead, and the new one may do well
            self._warn(component, f"closing what died raised {text_of(error)}", error)

    def _leave(self, slot: _Slot) -> None:
        with self._counting:
            slot.users -= 1
            if slot.users:
                return
            if self._slots.get(slot.key) is slot:
                del self._slots[slot.key]
        if slot.instance is not None:
            slot.instance.close()

    def _ended(self, channel: Channel, failure: Exception | None) -> None:
        if failure is None:
            self.report(Health.FINISHED, "its source has no more messages", channel=channel)
        else:
            cause = f"its source raised {text_of(failure)}"
            self._warn(channel.endpoint.component, cause, failure)
            self.report(Health.LOST, cause, channel=channel)

    def _warn(self, component: str, text: str, error: Exception) -> None:
        log = self._logs.setdefault(component, LimitedLog(f"uoarm.component.{component}"))
        log.write(logging.WARNING, f"component {component}: {text}", error)


def _key(endpoint: Endpoint) -> _Key:
    """Distinguish a component from the one of its name in another revision of the configuration."""
    given = endpoint.parameters
    return endpoint.component, endpoint.address, json.dumps(given, default=id) if given else ""


def _check_endpoint(address: tuple[str, ...], options: Options) -> str:
    del options
    return address_mistake(address)


def _check_parameters(
    address: tuple[str, ...], parameters: Options, options: PythonOptions
) -> Mapping[str, str]:
    modules = Modules.newest(options.path)
    try:
        return find(address, modules).parameter_mistakes(parameters)
    finally:
        modules.close()


def _describe_here(endpoint: Endpoint, options: PythonOptions) -> Description:
    modules = Modules.newest(options.path)
    try:
        return find(endpoint.address, modules).describe(endpoint)
    finally:
        modules.close()


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the built-in bridge type."""
    return [
        BridgeType(
            name="python",
            summary="plain Python functions, generators and classes, in this process",
            create=PythonBridge,
            bridge_options=PythonOptions,
            endpoint_options=EndpointOptions,  # it has none
            check_endpoint=_check_endpoint,
            check_parameters=_check_parameters,
            describe=_describe_here,
            contract=2,
        )
    ]
