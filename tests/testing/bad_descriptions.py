"""Bugs of what a bridge says and answers: descriptions, options and services."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from attrs import evolve
from tests.testing.bad_messages import late_in_other_words
from tests.testing.bad_worlds import OPTIONS_KIND, SERVICES, WORDS, BadWorld, Bug, Spoil, step
from tests.testing.test_memory_conformance import OPTIONS, at

from uoarm.bridge import Channel, Description, Discovered, Source
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Deliver, Endpoint, Message, MessageStructure, Role
from uoarm.testing import MemoryBridge
from uoarm.testing.conformance._describing import Declaring, Describing
from uoarm.testing.conformance._flow import ServiceRules

# Describing.


def boasts(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
    def described(endpoint: Endpoint) -> Description:
        try:
            return describe(endpoint)  # type: ignore[no-any-return]
        except BridgeError:
            return Description(MessageStructure({"type": "integer"}))

    return described


def refusing(text: str, reason: FailureReason) -> Spoil:
    def replace(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
        def described(endpoint: Endpoint) -> Description:
            try:
                return describe(endpoint)  # type: ignore[no-any-return]
            except BridgeError:
                raise BridgeError(text, reason) from None

        return described

    return step("_describe", replace)


def opens_nothing(world: BadWorld, bridge: MemoryBridge, opens: Any) -> Any:
    def opened(endpoint: Endpoint, structure: MessageStructure, deliver: Deliver) -> Source:
        try:
            return opens(endpoint, structure, deliver)  # type: ignore[no-any-return]
        except BridgeError:
            return Source(endpoint, lambda: None)

    return opened


def forgets_what_it_said(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
    count = iter(range(10**9))

    def described(endpoint: Endpoint) -> Description:
        said: Description = describe(endpoint)
        assert said.message is not None
        return evolve(said, message=evolve(said.message, native_type=f"Type{next(count)}"))

    return described


def schema_of(schema: Any) -> Spoil:
    said = Description(MessageStructure(schema))
    return step("_describe", lambda *_: lambda endpoint: said)


def takes_the_first_part(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
    return lambda endpoint: endpoint.address[0] and describe(endpoint)


def ghost(world: BadWorld, bridge: MemoryBridge, discover: Any) -> Any:
    seen = Discovered("ghost", ((at("ghost", Role.OUTPUT), Description()),))
    return lambda: (*discover(), seen)


def other_structure(world: BadWorld, bridge: MemoryBridge, discover: Any) -> Any:
    def discovered() -> tuple[Discovered, ...]:
        return tuple(
            evolve(
                component, endpoints=tuple((end, Description()) for end, _ in component.endpoints)
            )
            for component in discover()
        )

    return discovered


# Declarations.


def declares(**changed: Any) -> Spoil:
    def declares_otherwise(world: BadWorld, _: MemoryBridge) -> None:
        made = {key: value(world) if callable(value) else value for key, value in changed.items()}
        world.declared = evolve(world.declared, **made)

    return declares_otherwise


OPEN = {**OPTIONS, "additionalProperties": True}


ANYTHING = {**OPTIONS, "properties": {"links": {}}}


def _crashes(_: BadWorld) -> Any:
    return lambda address, options: "" if address[0] else "empty"


def _forgets_options(world: BadWorld) -> Any:
    return lambda name, options: MemoryBridge(name)


# Services.


def describes_no_reply(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
    return lambda endpoint: evolve(describe(endpoint), reply=None)


def answers_others(world: BadWorld, bridge: MemoryBridge, call: Any) -> Any:
    """Give every caller the first reply."""
    kept: list[Message] = []

    def called(*given: Any) -> Message:
        kept.append(call(*given))
        return kept[0]

    return called


def serves_errors(world: BadWorld, bridge: MemoryBridge, serve: Any) -> Any:
    def served(endpoint: Endpoint, structures: Any, handler: Any) -> Any:
        def handle(request: Message) -> Message:
            try:
                return handler(request)
            except ArithmeticError:
                return {}

        return serve(endpoint, structures, handle)

    return served


def serves_on(world: BadWorld, bridge: MemoryBridge, serve: Any) -> Any:
    def served(*given: Any) -> Channel:
        serve(*given)
        return Channel(given[0], lambda: None)

    return served


def _only_once(close: Callable[[], None]) -> Callable[[], None]:
    closes = [close]

    def close_once() -> None:
        closes.pop()()

    return close_once


DESCRIPTION_BUGS: tuple[Bug, ...] = (
    Bug(
        WORDS,
        "describes what is not there",
        step("_describe", boasts),
        Describing.test_what_is_not_there_is_named,
        "DID NOT RAISE",
    ),
    Bug(
        WORDS,
        "does not name what is not there",
        refusing("not found", FailureReason.NOT_FOUND),
        Describing.test_what_is_not_there_is_named,
        "does not name it",
    ),
    Bug(
        WORDS,
        "gives a wrong reason for what is not there",
        refusing("nowhere: 404", FailureReason.RAISED),
        Describing.test_what_is_not_there_is_named,
        "expected NOT_FOUND or UNAVAILABLE",
    ),
    Bug(
        WORDS,
        "has the framework's own exception for an address without parts",
        step("_describe", takes_the_first_part),
        Describing.test_an_address_without_parts_is_refused,
        "expected NOT_FOUND or UNAVAILABLE or BAD_ENDPOINT",
    ),
    Bug(
        WORDS,
        "opens what is not there",
        step("_open_source", opens_nothing),
        Describing.test_what_is_not_there_does_not_open,
        "DID NOT RAISE",
    ),
    Bug(
        WORDS,
        "describes an endpoint anew each time",
        step("_describe", forgets_what_it_said),
        Describing.test_describing_twice_says_the_same,
        "was described by",
    ),
    Bug(
        WORDS,
        "describes with what is no JSON Schema",
        schema_of({"type": "byte"}),
        Describing.test_structures_are_valid_schemas_with_messages,
        "'byte' is not valid",
    ),
    Bug(
        WORDS,
        "describes with a schema of an older draft",
        schema_of({"$schema": "http://json-schema.org/draft-07/schema#", "type": "string"}),
        Describing.test_structures_are_valid_schemas_with_messages,
        "it is of draft 2020-12",
    ),
    Bug(
        WORDS,
        "describes what no message fits",
        schema_of({"type": "integer", "enum": []}),
        Describing.test_structures_are_valid_schemas_with_messages,
        "no message fits",
    ),
    Bug(
        WORDS,
        "discovers what cannot be described",
        step("_discover", ghost),
        Describing.test_discovered_components_can_be_described,
        "no component at ['ghost']",
    ),
    Bug(
        WORDS,
        "discovers other structures than it describes",
        step("_discover", other_structure),
        Describing.test_discovered_components_can_be_described,
        "is described by",
    ),
    Bug(
        WORDS,
        "has an attribute with the name of a step",
        step("_link", lambda *_: "a link"),
        Declaring.test_no_attribute_hides_a_step,
        "hide what `Bridge` has under these names: ['_link']",
    ),
)


OPTION_BUGS: tuple[Bug, ...] = (
    Bug(
        OPTIONS_KIND,
        "takes options that it does not know",
        declares(bridge_options=OPEN),
        Declaring.test_an_option_that_is_not_known_is_refused,
        "DID NOT RAISE",
    ),
    Bug(
        OPTIONS_KIND,
        "takes any value of an option",
        declares(bridge_options=ANYTHING),
        Declaring.test_an_option_of_a_wrong_type_is_refused,
        "'links' takes whatever it is given",
    ),
    Bug(
        OPTIONS_KIND,
        "does not hand its options on",
        declares(create=_forgets_options),
        Declaring.test_the_options_reach_the_bridge,
        ", got {}",
    ),
    Bug(
        OPTIONS_KIND,
        "fails at an address without parts",
        declares(check_endpoint=_crashes),
        Declaring.test_addresses_are_checked_in_words_without_the_framework,
        "index out of range",
    ),
    Bug(
        OPTIONS_KIND,
        "takes any address",
        declares(check_endpoint=lambda w: lambda address, options: ""),
        Declaring.test_addresses_are_checked_in_words_without_the_framework,
        "an address without parts is taken for right",
    ),
)


SERVICE_BUGS: tuple[Bug, ...] = (
    Bug(
        SERVICES,
        "returns the request for the reply",
        step("_call", lambda *_: lambda endpoint, structures, message, timeout: message),
        ServiceRules.test_a_call_returns_the_reply,
        "the reply is {'value': 21}",
    ),
    Bug(
        SERVICES,
        "does not describe a reply",
        step("_describe", describes_no_reply),
        ServiceRules.test_a_service_is_described_by_request_and_reply,
        "it is described without a reply",
    ),
    Bug(
        SERVICES,
        "gives a caller the reply to another request",
        step("_call", answers_others),
        ServiceRules.test_several_threads_may_call_at_once,
        "the reply to {'value'",
    ),
    Bug(
        SERVICES,
        "ends a call that is late with an error of another class",
        step("_call", late_in_other_words),
        ServiceRules.test_a_service_that_is_silent_ends_in_time,
        "no reply came",
    ),
    Bug(
        SERVICES,
        "answers with nothing when a served function raises",
        step("_serve", serves_errors),
        ServiceRules.test_a_served_function_that_raises_fails_its_caller,
        "DID NOT RAISE",
    ),
    Bug(
        SERVICES,
        "serves on after the close",
        step("_serve", serves_on),
        ServiceRules.test_a_served_function_answers_until_it_is_closed,
        "DID NOT RAISE",
    ),
)
