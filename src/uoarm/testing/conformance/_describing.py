"""Does the bridge describe its endpoints truly, and refuse with the right reasons?"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import pytest
from attrs import evolve
from jsonschema import Draft202012Validator

from uoarm.bridge import CONTRACT_VERSION, Bridge, BridgeType
from uoarm.errors import BridgeError, ConfigurationError, FailureReason
from uoarm.model import BridgeSpec, Role
from uoarm.schema import newest
from uoarm.testing._resources import ResourceSnapshot
from uoarm.testing.conformance._world import (
    World,
    example_of,
    line,
    rules,
    structure_of,
    supplied,
)

_FAILURES = 5
_ABSENT = (FailureReason.NOT_FOUND, FailureReason.UNAVAILABLE)
_REFUSED = (*_ABSENT, FailureReason.BAD_ENDPOINT)
_ODD: tuple[Any, ...] = (None, True, -1, 0.5, "no such value", [None], {"no such": "thing"})
_ADDRESSES: tuple[tuple[str, ...], ...] = ((), ("",), ("",) * 12)


@rules("the-steps")
class Describing:
    """`describe` and `discover`."""

    def test_structures_are_valid_schemas_with_messages(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        pair = world.pair(kind)
        for incoming in (True, False):
            structure = structure_of(bridge, pair, incoming=incoming)
            Draft202012Validator.check_schema(structure.schema)
            assert newest(structure.schema) is structure.schema, "it is of draft 2020-12"
            assert example_of(structure) is not None

    def test_describing_twice_says_the_same(self, world: World, bridge: Bridge, kind: str) -> None:
        pair = world.pair(kind)
        for endpoint in (pair.sink, pair.source):
            first, again = bridge.describe(endpoint), bridge.describe(endpoint)
            assert first == again, f"{endpoint} was described by {first}, then by {again}"

    def test_describing_says_the_same_while_messages_pass(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        pair = world.pair(kind)
        before = [bridge.describe(endpoint) for endpoint in (pair.sink, pair.source)]
        with line(world, bridge, kind) as through:
            through.carries(through.example())
            for endpoint, first in zip((pair.sink, pair.source), before, strict=True):
                again = bridge.describe(endpoint)
                assert first == again, f"{endpoint} was described by {first}, then by {again}"

    def test_what_is_not_there_is_named(self, world: World, bridge: Bridge) -> None:
        endpoint = world.missing()
        with pytest.raises(BridgeError) as caught:
            bridge.describe(endpoint)
        _hold_reason(caught.value, _ABSENT)
        words = re.split(r"[^\w]+", " ".join(endpoint.address))
        text = str(caught.value.__cause__ or caught.value)
        assert any(word in text for word in words if word), f"{text!r} does not name it"

    def test_what_is_not_there_does_not_open(self, world: World, bridge: Bridge, kind: str) -> None:
        structure = structure_of(bridge, world.pair(kind), incoming=False)
        missing = world.missing()
        with pytest.raises(BridgeError) as caught:
            bridge.open_source(missing, structure, lambda _: None)
        _hold_reason(caught.value, _ABSENT)
        with pytest.raises(BridgeError) as caught:
            bridge.open_sink(evolve(missing, role=Role.INPUT), structure)
        _hold_reason(caught.value, _REFUSED)  # its address may say that it is an output
        assert bridge.open_channels == 0

    def test_what_does_not_open_leaves_nothing_behind(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        structure = structure_of(bridge, world.pair(kind), incoming=False)
        missing = world.missing()

        def fail() -> None:
            for step in (
                lambda: bridge.describe(missing),
                lambda: bridge.open_source(missing, structure, lambda _: None),
                lambda: bridge.open_sink(evolve(missing, role=Role.INPUT), structure),
            ):
                with pytest.raises(BridgeError):
                    step()

        fail()
        snapshot = ResourceSnapshot()
        for _ in range(_FAILURES):
            fail()
        snapshot.check(world.patience)

    def test_an_address_without_parts_is_refused(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with pytest.raises(BridgeError) as caught:
            bridge.describe(evolve(world.pair(kind).source, address=()))
        _hold_reason(caught.value, _REFUSED)

    def test_discovered_components_can_be_described(self, bridge: Bridge) -> None:
        if not bridge.capabilities.discover:
            pytest.skip("the bridge does not discover components")
        found = bridge.discover()
        assert found, "nothing was discovered, though the world has components"
        for component in found:
            for endpoint, description in component.endpoints:
                report = bridge.describe(endpoint)
                assert report == description, (
                    f"{endpoint} is described by {report}, not {description}"
                )


def _hold_reason(error: BridgeError, allowed: Collection[FailureReason]) -> None:
    """Hold that a refusal has a reason that fits: RAISED is an exception that came by itself."""
    names = " or ".join(reason.name for reason in allowed)
    assert error.reason in allowed, f"the reason is {error.reason}, expected {names}: {error}"


@rules("the-declaration")
class Declaring:
    """The plugin behind the entry point: its options and what it checks without the framework."""

    @pytest.fixture
    def spec(self, world: World) -> BridgeSpec:
        """The bridge as a configuration has it, or a skip where the world does not say."""
        return supplied(world.spec(), "the world does not say what a configuration would: `spec`")

    @pytest.fixture
    def declared(self, world: World, spec: BridgeSpec) -> BridgeType:
        """The declaration of the plugin."""
        registry = world.registry()
        assert spec.plugin in registry.types, registry.missing(spec.plugin)
        return registry.types[spec.plugin]

    def test_the_plugin_states_the_contract_of_this_uoarm(self, declared: BridgeType) -> None:
        assert declared.contract == CONTRACT_VERSION
        assert declared.summary
        Draft202012Validator.check_schema(declared.options_schema)

    def test_no_attribute_hides_a_step(self, bridge: Bridge) -> None:
        steps = {name for name in dir(Bridge) if callable(getattr(Bridge, name))}
        hidden = [
            name for name in vars(bridge) if name in steps and not callable(vars(bridge)[name])
        ]
        assert not hidden, f"attributes hide what `Bridge` has under these names: {hidden}"

    def test_the_options_reach_the_bridge(self, world: World, spec: BridgeSpec) -> None:
        registry = world.registry()
        made = registry.create(spec)
        expected: Any = registry.types[spec.plugin].value_of(spec.options, spec.folder)
        try:
            assert made.name == spec.name
            assert made.options == expected, (
                f"expected the options {expected!r}, got {made.options!r}"
            )
        finally:
            made.close()

    def test_an_option_that_is_not_known_is_refused(self, world: World, spec: BridgeSpec) -> None:
        unknown = evolve(spec, options={**spec.options, "no_such_option": 1})
        with pytest.raises(ConfigurationError, match="no_such_option"):
            _create(world, unknown)

    def test_an_option_of_a_wrong_type_is_refused(
        self, world: World, spec: BridgeSpec, declared: BridgeType
    ) -> None:
        schema: Any = declared.options_schema
        for name in schema.get("properties", {}):
            for value in _ODD:
                try:
                    _create(world, evolve(spec, options={**spec.options, name: value}))
                except ConfigurationError:
                    break
            else:
                raise AssertionError(f"the option {name!r} takes whatever it is given")

    def test_an_option_of_a_port_that_is_not_known_is_refused(
        self, world: World, declared: BridgeType, kind: str
    ) -> None:
        pair = world.pair(kind)
        for endpoint in (pair.sink, pair.source):
            options = {**endpoint.options, "no_such_option": 1}
            if declared.endpoint_options is not None:
                with pytest.raises(ValueError, match="no_such_option"):
                    declared.endpoint_options.of(options)
                continue
            check = declared.check_endpoint
            wrong = "" if check is None else check(endpoint.address, options)
            assert wrong, "it is taken: declare `endpoint_options`, or have `check_endpoint` say so"

    def test_each_default_is_what_may_be_written(self, declared: BridgeType) -> None:
        kind = declared.endpoint_options
        for schema in (declared.options_schema, {} if kind is None else kind.schema()):
            for name, known in _known_options(schema):
                if "default" in known:
                    found = list(Draft202012Validator(known).iter_errors(known["default"]))
                    assert not found, f"{name}: its default is refused: {found[0].message}"

    def test_an_option_that_is_required_is_missed(
        self, world: World, spec: BridgeSpec, declared: BridgeType
    ) -> None:
        """By the schema and by name: what `create` finds missing comes too late."""
        schema: Any = declared.options_schema
        required = set(schema.get("required", ()))
        for name in {*spec.options} | required:
            left = {key: value for key, value in spec.options.items() if key != name}
            if name in required:
                with pytest.raises(ConfigurationError, match=re.escape(name)):
                    _create(world, evolve(spec, options=left))
                continue
            try:
                _create(world, evolve(spec, options=left))
            except Exception as error:
                raise AssertionError(f"{name!r} is needed, and not required: {error!r}") from error

    def test_addresses_are_checked_in_words_without_the_framework(
        self, world: World, declared: BridgeType, kind: str
    ) -> None:
        check = supplied(declared.check_endpoint, "the plugin does not check addresses")
        for address in _ADDRESSES:
            assert isinstance(check(address, {}), str)
        assert check((), {}), "an address without parts is taken for right"
        pair = world.pair(kind)
        for endpoint in (pair.sink, pair.source):
            assert check(endpoint.address, endpoint.options) == ""


def _known_options(schema: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the options that a schema describes, those within others too, by their paths."""
    if isinstance(schema, Mapping):
        for name, known in schema.get("properties", {}).items():
            yield f"{at}{name}", known
            yield from _known_options(known, f"{at}{name}.")
        for part in ("additionalProperties", "items"):
            yield from _known_options(schema.get(part), at)


def _create(world: World, spec: BridgeSpec) -> Bridge:
    """Make a bridge that is expected to be refused; what is made all the same is closed."""
    made = world.registry().create(spec)
    made.close()
    return made
