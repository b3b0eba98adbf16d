"""From plain values of the right shape to the model's values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path as FilePath
from typing import Any

from attrs import evolve

from uoarm._support.files import expanded
from uoarm.model import (
    BridgeSpec,
    CommandPolicy,
    Component,
    Endpoint,
    Expectation,
    FailoverPolicy,
    FailureLimits,
    FieldLimit,
    Function,
    Input,
    LeasePolicy,
    Listening,
    LockMode,
    Meaning,
    MeaningLevel,
    MessageStructure,
    Need,
    Offer,
    OfferedPort,
    OfferedService,
    Output,
    OverflowPolicy,
    PortRef,
    QueuePolicy,
    RecordSettings,
    Robot,
    Role,
    Service,
    StopMessage,
)


def build(value: Mapping[str, Any], origin: str, warnings: tuple[str, ...]) -> Robot:
    """Return the robot that a checked configuration describes."""
    bridges = {name: _bridge(name, bridge, origin) for name, bridge in value["bridges"].items()}
    meaning = _meaning(value)
    functions = {name: _function(name, item, meaning) for name, item in value["functions"].items()}
    asked = value.get("applications", {})
    applications = {name: tuple(names) for name, names in asked.items()}
    failover = value.get("failover", {})
    limits = FailureLimits(**failover.get("failing", {}))
    hosts = _listening(value["hosts"], origin) if "hosts" in value else None
    offers = tuple(
        _offer(bridge, function, item, _at_level(value["functions"][function], meaning))
        for bridge, offered in value.get("offer", {}).items()
        for function, item in offered.items()
    )
    lock = LockMode(value["lock"]) if "lock" in value else None
    # A relative path would be another one where the program changes its working directory.
    file = str(FilePath(origin).absolute()) if origin else ""
    record = _record(value["record"], origin) if "record" in value else None
    return Robot(
        bridges,
        functions,
        warnings,
        file,
        applications,
        FailoverPolicy(**{**failover, "failing": limits}),
        hosts,
        offers,
        lock,
        record=record,
        exports={role: tuple(names) for role, names in value.get("export", {}).items()},
    )


def _record(value: Mapping[str, Any], origin: str) -> RecordSettings:
    options = {key: item for key, item in value.items() if key not in {"functions", "path"}}
    path = _located(value["path"], origin) if origin else value["path"]
    return RecordSettings(tuple(value["functions"]), path, options)


def _listening(value: Mapping[str, Any], origin: str) -> Listening:
    settings = {key: item for key, item in value.items() if key != "listen"}
    if "certificates" in settings and origin:
        settings["certificates"] = _located(settings["certificates"], origin)
    return Listening(value["listen"], **settings)


def folder_of(origin: str) -> str:
    """Return the folder in which relative paths of a configuration begin; "": of one in memory."""
    return str(FilePath(origin).resolve().parent) if origin else ""


def _located(path: str, origin: str) -> str:
    return str(FilePath(folder_of(origin), expanded(path)))


def _ports(component: Mapping[str, Any], single: str, several: str) -> dict[str, Any]:
    """Return the ports of a component by name, whichever of the two spellings it uses."""
    named = dict(component.get(several, {}))
    if single in component:
        named["default"] = component[single]
    return named


def _bridge(name: str, value: Mapping[str, Any], origin: str) -> BridgeSpec:
    plugin = value.get("plugin", name)
    host = value.get("host", False)
    elsewhere = isinstance(host, dict) and "machine" in host
    here = "" if elsewhere else origin  # on another machine they are that one's paths
    options = bridge_options(plugin, value.get("options", {}), here)
    if isinstance(host, bool):
        settings: dict[str, Any] | None = {} if host else None
    else:
        settings = dict(host)
        if "python" in settings and origin:
            settings["python"] = _located(settings["python"], origin)
    return BridgeSpec(name, plugin, options, settings, folder=folder_of(here))


def bridge_options(plugin: str, written: Mapping[str, Any], origin: str) -> dict[str, Any]:
    """Return the options of a bridge; modules of Python are found beside the file."""
    options = dict(written)
    if plugin == "python" and "path" not in options and origin:
        options["path"] = [folder_of(origin)]
    return options


def _meaning(value: Mapping[str, Any]) -> Meaning:
    """Return how the robot judges meaning where no function and no input says otherwise."""
    alike = tuple(frozenset(names) for names in value.get("alike", ()))
    return _at_level(value, Meaning(alike=alike))


def _at_level(value: Mapping[str, Any], meaning: Meaning) -> Meaning:
    return evolve(meaning, level=MeaningLevel(value["meaning"])) if "meaning" in value else meaning


def _function(name: str, value: Mapping[str, Any], meaning: Meaning) -> Function:
    meaning = _at_level(value, meaning)
    components = [_component(name, component, meaning) for component in value.get("components", ())]
    components.sort(key=lambda component: -component.priority)
    needs = _need(value["needs"]) if "needs" in value else None
    return Function(
        name,
        tuple(components),
        value.get("description", ""),
        needs,
        approve=value.get("approve", False),
    )


def _need(value: Mapping[str, Any]) -> Need:
    def several(key: str) -> tuple[str, ...]:
        written = value.get(key, ())
        return (written,) if isinstance(written, str) else tuple(written)

    return Need(
        role=Role(value.get("role", "output")),
        structure=_structure(value, "structure"),
        request=_structure(value, "request"),
        reply=_structure(value, "reply"),
        like=value.get("like", ""),
        names=several("name"),
        ports=several("port"),
        labels=several("label"),
        prefer=several("prefer"),
        exclude=several("exclude"),
        unfed=several("unfed"),
        from_application=several("from_application"),
        mapping=value.get("map", {}),
        options=value.get("options", {}),
        refuse_ambiguous=value.get("ambiguous", "first") == "refuse",
    )


def _component(function: str, value: Mapping[str, Any], meaning: Meaning) -> Component:
    def endpoint(port: str, settings: Mapping[str, Any], role: Role) -> Endpoint:
        return Endpoint(
            bridge=value["bridge"],
            component=value["name"],
            role=role,
            address=tuple(settings["endpoint"]),
            port=port,
            options=settings.get("options", {}),
            parameters=value.get("parameters", {}),
            command=_command(settings),
        )

    service = value.get("service")
    return Component(
        name=value["name"],
        function=function,
        bridge=value["bridge"],
        priority=int(value.get("priority", 0)),
        inputs=tuple(
            _input(port, item, endpoint(port, item, Role.INPUT), meaning)
            for port, item in _ports(value, "input", "inputs").items()
        ),
        outputs=tuple(
            Output(
                port,
                endpoint(port, item, Role.OUTPUT),
                _structure(item, "structure"),
                Expectation(**item["expect"]) if "expect" in item else None,
            )
            for port, item in _ports(value, "output", "outputs").items()
        ),
        service=None
        if service is None
        else Service(
            endpoint("default", service, Role.SERVICE),
            _structure(service, "request"),
            _structure(service, "reply"),
        ),
        parameters=value.get("parameters", {}),
    )


def _input(port: str, value: Mapping[str, Any], endpoint: Endpoint, meaning: Meaning) -> Input:
    if endpoint.command is not None:
        meaning = evolve(meaning, level=MeaningLevel.STRICT)
    return Input(
        name=port,
        endpoint=endpoint,
        source=_reference(value["from"]) if "from" in value else None,
        mapping=value.get("map"),
        allow_loss=tuple(value.get("allow_loss", ())),
        declared=_structure(value, "structure"),
        queue=_queue(value["queue"]) if "queue" in value else None,
        meaning=_at_level(value, meaning),
    )


def _command(value: Mapping[str, Any]) -> CommandPolicy | None:
    """Return how an input that moves something is kept safe, None for any other."""
    if not {"lifetime", "stop", "limits", "lease"} & set(value):
        return None
    return CommandPolicy(
        lifetime=value.get("lifetime"),
        stop=StopMessage(value["stop"]["message"]) if "stop" in value else None,
        limits=tuple(FieldLimit(path, **limit) for path, limit in value.get("limits", {}).items()),
        lease=_lease(value["lease"]) if "lease" in value else None,
    )


def _lease(value: Mapping[str, Any]) -> LeasePolicy:
    return LeasePolicy(value["duration"], tuple(value.get("priorities", {}).items()))


def _offer(bridge: str, function: str, value: Mapping[str, Any], meaning: Meaning) -> Offer:
    offer = Offer(bridge, function)

    def endpoint(port: str, settings: Mapping[str, Any], role: Role) -> Endpoint:
        address, options = tuple(settings["endpoint"]), settings.get("options", {})
        return Endpoint(bridge, offer.name, role, address, port, options, is_offered=True)

    def ports(single: str, several: str, role: Role) -> tuple[OfferedPort, ...]:
        return tuple(
            OfferedPort(
                port,
                endpoint(port, settings, role),
                settings.get("map"),
                tuple(settings.get("allow_loss", ())),
                _structure(settings, "structure"),
                _queue(settings["queue"]) if "queue" in settings else None,
                _at_level(settings, meaning),
            )
            for port, settings in _ports(value, single, several).items()
        )

    service = value.get("service")
    return evolve(
        offer,
        outputs=ports("output", "outputs", Role.INPUT),
        inputs=ports("input", "inputs", Role.OUTPUT),
        service=None if service is None else _offered_service(service, endpoint, meaning),
    )


def _offered_service(
    value: Mapping[str, Any], endpoint: Callable[..., Endpoint], meaning: Meaning
) -> OfferedService:
    maps, losses = value.get("map", {}), value.get("allow_loss", {})
    return OfferedService(
        endpoint("default", value, Role.SERVICE),
        _structure(value, "request"),
        _structure(value, "reply"),
        maps.get("request"),
        maps.get("reply"),
        tuple(losses.get("request", ())),
        tuple(losses.get("reply", ())),
        float(value.get("timeout", 10)),
        _at_level(value, meaning),
    )


def _reference(text: str) -> PortRef:
    function, _, port = text.partition(".")
    return PortRef(function, port or None)


def _queue(value: Mapping[str, Any]) -> QueuePolicy:
    standard = QueuePolicy()
    return QueuePolicy(
        length=int(value.get("length", standard.length)),
        policy=OverflowPolicy(value.get("policy", standard.policy.value)),
        timeout=float(value.get("timeout", standard.timeout)),
        octets=int(value.get("octets", standard.octets)),
    )


def _structure(value: Mapping[str, Any], key: str) -> MessageStructure | None:
    return MessageStructure(value[key]) if key in value else None
