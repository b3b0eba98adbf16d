"""Targets: the Python object behind `module:attribute`, its message structures and parameters.

What was written for a component's parameters is held against its signature and its hints.
"""

from __future__ import annotations

import inspect
from collections.abc import (
    AsyncIterable,
    AsyncIterator,
    Callable,
    Hashable,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from functools import cached_property, partial
from pathlib import PurePath
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

import attrs
from attrs import field, frozen

from uoarm._arguments import arguments
from uoarm._hints.arrays import HintError
from uoarm._hints.convert import reader
from uoarm._hints.schemas import read_hints, schema_of, signature
from uoarm._mistakes import schema_mistakes
from uoarm._raised import foreign, text_of
from uoarm._spelling import Speller, did_you_mean
from uoarm.bridge import Description
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.local._modules import Modules, written_name
from uoarm.local._port import TargetPort
from uoarm.model import Endpoint, Message, MessageStructure, Options, Role, Schema


def parameter_mistakes(
    accepted: Mapping[str, inspect.Parameter],
    hints: Mapping[str, Any],
    message: str | None,
    given: Options,
) -> dict[str, str]:
    """Return what is wrong with parameters, by name; nothing where they fit.

    Args:
        accepted: the parameters of a function or class, without the one that takes messages.
        hints: their type hints; what has none, or one without a structure, takes everything.
        message: the name of the parameter that takes messages, where a function has one.
        given: the values in the configuration.
    """
    found: dict[str, str] = {}
    takes_all = any(parameter.kind is parameter.VAR_KEYWORD for parameter in accepted.values())
    named = {parameter.name for parameter in accepted.values() if parameter.kind in _NAMED}
    for name, value in given.items():
        if name in named:
            wrong = _misfit(value, hints.get(name, inspect.Parameter.empty))
            if wrong:
                found[name] = wrong
        elif not takes_all:
            known = f"there are {', '.join(sorted(named))}" if named else "it takes none"
            hint = did_you_mean(name, named) or f": {known}"
            found[name] = f"there is no such parameter{hint}"
    for name in sorted(named - given.keys()):
        if accepted[name].default is inspect.Parameter.empty:
            whole = f"; each message comes whole, in {message!r}" if message else ""
            found[name] = f"it has no value: give it one under `parameters`{whole}"
    return found


def build_parameters(hints: Mapping[str, Any], given: Options, place: str) -> dict[str, Any]:
    """Return the parameters as the values that their hints say.

    Raises:
        MessageError: a value does not fit its hint.
    """
    built: dict[str, Any] = {}
    for name, value in given.items():
        read = reader(hints.get(name, Any), f"the parameter {name!r} of {place}")
        built[name] = value if read is None else read(value)
    return built


_NAMED = {inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY}


def _misfit(value: object, hint: Any) -> str:
    """Return what is wrong with a value, "" where it fits or the hint says nothing."""
    try:
        schema: Schema = schema_of(hint)
    except HintError:
        schema = True
    reports = [
        f"{'.'.join(map(str, path))}: {sentence}" if path else sentence
        for path, sentence, _, _ in schema_mistakes(value, schema, Speller())
    ]
    if not reports:
        try:
            reader(hint, "it")
        except HintError as error:
            return str(error)
    return "; ".join(reports)


F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")
_DECLARED = "__uoarm_structures__"
_NOTHING = inspect.Parameter.empty


@attrs.frozen
class Emit:
    """A message for a named output, for components with several."""

    port: str
    message: Message


@arguments()
def structure(
    *,
    input: Schema | None = None,  # noqa: A002 - the port's own name
    output: Schema | None = None,
    request: Schema | None = None,
    reply: Schema | None = None,
) -> Callable[[F], F]:
    """Declare the message structures of a component instead of hinting them.

    They are JSON Schemas of draft 2020-12, or of an older one that `$schema` names.
    """
    given = {"input": input, "output": output, "request": request, "reply": reply}

    def mark(target: F) -> F:
        setattr(
            target, _DECLARED, {key: value for key, value in given.items() if value is not None}
        )
        return target

    return mark


@frozen
class Target:
    """A Python object that can be a component: a function, a generator function or a class.

    Its hints and signatures are read once, and what converts its messages is made once: that takes
    longer than all else of an opening.
    """

    name: str
    value: Any
    _hints_of: dict[Any, dict[str, Any]] = field(factory=dict, init=False, eq=False, repr=False)
    _parameters_of: dict[Any, list[inspect.Parameter]] = field(
        factory=dict, init=False, eq=False, repr=False
    )
    _ports: dict[Hashable, TargetPort] = field(factory=dict, init=False, eq=False, repr=False)
    _checked: list[Options] = field(factory=list, init=False, eq=False, repr=False)

    @cached_property
    def is_class(self) -> bool:
        """Whether an instance is built for each component."""
        return inspect.isclass(self.value)

    def source_name(self) -> str | None:
        """Return the name of the method with which a class is a source; None where it is none."""
        names = ("__iter__", "__aiter__")
        return next((name for name in names if self.own(name) is not None), None)

    def method(self, endpoint: Endpoint) -> Any:
        """Return the callable behind a port, unbound; None for outputs that other methods feed.

        Raises:
            BridgeError: there is none.
        """
        if not self.is_class:
            return self.value
        if endpoint.role is Role.OUTPUT:
            found = self._own_method(self.source_name() or "__call__")
            if found is not None or any(
                inspect.isfunction(item) and not name.startswith("_")
                for name, item in inspect.getmembers(self.value)
            ):
                return found
            text = f"{self.name} has no method that gives messages: __iter__, __call__ or others"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        name = "__call__" if endpoint.port == "default" else endpoint.port
        found = self._own_method(name)
        if found is None:
            text = f"{self.name} has no method {name!r} for the port {endpoint.port!r}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return found

    def describe(self, endpoint: Endpoint) -> Description:
        """Return the structures of a port, from its declaration or its hints.

        Raises:
            BridgeError: it has no such port, a hint without a structure, or the component's
                parameters do not fit.
        """
        self.require_parameters(endpoint.parameters)
        method = self.method(endpoint)
        declared: Mapping[str, Schema] = getattr(self.value, _DECLARED, {})
        declared = {**declared, **getattr(method, _DECLARED, {})}
        self._require_role(endpoint, method, is_declared="output" in declared)
        port = self.port(endpoint)
        if endpoint.role is not Role.OUTPUT or not port.takes_messages:
            port.require_conversion()

        def read(part: str) -> MessageStructure | None:
            if part in declared:
                return self._declared(part, declared[part])
            if method is None:
                return None
            return self._derived(part, endpoint, self._type_hints(method))

        if endpoint.role is Role.SERVICE:
            known = Description(request=read("request"), reply=read("reply"))
            unknown = [part for part in ("request", "reply") if getattr(known, part) is None]
        elif endpoint.role is Role.INPUT:
            known = Description(read("input"))
            unknown = ["input"] if known.message is None else []
        elif endpoint.port == "default":
            known = Description(read("output"), needs_input=port.takes_messages)
            unknown = ["output"] if known.message is None else []
        else:  # what is emitted for a named output is in no hint
            return Description(needs_input=port.takes_messages)
        hints = [] if method is None else [self._wanted(part, endpoint) for part in unknown]
        return attrs.evolve(known, hint=", and ".join(dict.fromkeys(hints)))

    def _require_role(self, endpoint: Endpoint, method: Any, *, is_declared: bool) -> None:
        """Refuse a port that the signature of its callable does not allow.

        Raises:
            BridgeError: with BAD_ENDPOINT.
        """
        wrong = ""
        if endpoint.role is not Role.OUTPUT:
            taken = self.message_parameter(endpoint)
            accepted = {item.name: item for item in self._parameters(method)[1:]}
            accepted.pop(taken, None)
            if self.is_class and (unfilled := [*parameter_mistakes(accepted, {}, taken, {})]):
                wrong = f"each message comes whole, in {taken!r}: nothing fills {unfilled[0]!r}"
            elif endpoint.role is Role.SERVICE and generates(method):
                wrong = "it yields messages, and a service returns one reply"
        elif not (self.is_class or self.port(endpoint).takes_messages):
            hint = _NOTHING if is_declared else self.hints(method).get("return", _NOTHING)
            wrong = _no_source(method, hint)
        if wrong:
            name = f"{self.name}, {method.__name__}" if self.is_class else self.name
            raise BridgeError(f"{name}: {wrong}", FailureReason.BAD_ENDPOINT)

    def _wanted(self, part: str, endpoint: Endpoint) -> str:
        """Return which type hint is missing, as it would be written."""
        method = self.method(endpoint)
        hint = self._hint(part, endpoint, self._type_hints(method))
        if hint is not _NOTHING:
            return f"have {self.name} say what is in {hint}: write a TypedDict or a dataclass"
        if part in {"input", "request"}:
            name = self.message_parameter(endpoint)
            return f"give {name!r} of {self.name} a type hint, such as `{name}: float`"
        kind = "AsyncIterator" if inspect.isasyncgenfunction(method) else "Iterator"
        returned = f"{kind}[float]" if generates(method) else "float"
        return f"give {self.name} a type hint of what it returns, such as `-> {returned}`"

    def port(self, endpoint: Endpoint) -> TargetPort:
        """Return what is made once for a port, with these parameters: they fill others."""
        given = endpoint.parameters
        key = endpoint.role, endpoint.port, frozenset(given) if given else ()
        found = self._ports.get(key)
        if found is None:
            found = self._ports[key] = TargetPort(self, endpoint)
        return found

    def before_message(self, endpoint: Endpoint) -> tuple[str, ...]:
        """Return the names of the parameters of a function that come before the message's."""
        names = [parameter.name for parameter in self._parameters(self.method(endpoint))]
        return tuple(names[: names.index(self.message_parameter(endpoint))])

    def parameter_mistakes(self, given: Options) -> dict[str, str]:
        """Return what is wrong with a component's parameters, by name."""
        return parameter_mistakes(*self._accepted(given), given)

    def require_parameters(self, given: Options) -> None:
        """Refuse parameters that do not fit.

        Raises:
            BridgeError: with BAD_ENDPOINT; the text names each of them.
        """
        if not given and self._checked:  # none were right before
            return
        wrong = self.parameter_mistakes(given)
        if wrong:
            text = "; ".join(f"parameter {name!r}: {what}" for name, what in wrong.items())
            raise BridgeError(f"{self.name}: {text}", FailureReason.BAD_ENDPOINT)
        if not given:
            self._checked.append(given)

    def build_parameters(self, given: Options) -> dict[str, Any]:
        """Return parameters as the values that their hints say.

        Raises:
            BridgeError: they do not fit.
        """
        self.require_parameters(given)
        return build_parameters(self._accepted(given)[1], given, self.name) if given else {}

    def _accepted(
        self, given: Options
    ) -> tuple[dict[str, inspect.Parameter], dict[str, Any], str | None]:
        """Return the parameters of a component, their hints, and which takes messages, if one."""
        try:
            accepted = {parameter.name: parameter for parameter in self._parameters(self.value)}
        except ValueError:  # what is written in C may have no signature
            return {"_": inspect.Parameter("_", inspect.Parameter.VAR_KEYWORD)}, {}, None
        if self.is_class:
            return accepted, self.hints(self.value.__init__), None
        message = self.first_unfilled(self.value, given)
        accepted.pop(message or "", None)
        return accepted, self.hints(self.value), message

    def own(self, name: str) -> Any:
        """Return an attribute of the class, not of its metaclass, where `__call__` always is."""
        if any(name in vars(item) for item in self.value.__mro__):
            return getattr(self.value, name, None)
        return None

    def _own_method(self, name: str) -> Any:
        """Return a method of the class, which takes `self` first; None where it has none.

        Raises:
            BridgeError: it has something else of that name.
        """
        found = self.own(name)
        written = inspect.getattr_static(self.value, name, None)
        kind = type(written).__name__
        if isinstance(written, staticmethod | classmethod) or not (
            found is None or callable(found)
        ):
            text = f"{self.name}.{name} is of type {kind}: a port needs a method, with self first"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return found

    def _declared(self, part: str, schema: Schema) -> MessageStructure:
        from uoarm.schema import SchemaError, newest  # noqa: PLC0415 - slow import, rarely needed

        try:
            return MessageStructure(newest(schema))
        except SchemaError as error:
            text = f"{self.name}: its structure of {part} is no JSON Schema: {error}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT) from error

    def _derived(
        self, part: str, endpoint: Endpoint, hints: Mapping[str, Any]
    ) -> MessageStructure | None:
        hint = self._hint(part, endpoint, hints)
        if hint is _NOTHING:
            return None
        try:
            return MessageStructure(schema_of(hint), native_type=getattr(hint, "__name__", ""))
        except HintError as error:
            if _is_open(hint):  # what comes is passed on as it is: the configuration may say what
                return None
            raise HintError(f"{self.name}: {error}") from error

    def _hint(self, part: str, endpoint: Endpoint, hints: Mapping[str, Any]) -> Any:
        if part in {"input", "request"}:
            return hints.get(self.message_parameter(endpoint), _NOTHING)
        return self.return_hint(endpoint, hints)

    def return_hint(self, endpoint: Endpoint, hints: Mapping[str, Any]) -> Any:
        """Return the hint of one message: of what a source or a generator yields, without `Emit`.

        None is silence, and no message, but for a service, which always replies.
        """
        method, role = self.method(endpoint), endpoint.role
        is_source = role is Role.OUTPUT and not self.port(endpoint).takes_messages
        hint = _of_several(hints.get("return", _NOTHING), iterables=is_source or generates(method))
        others = {Emit} if role is Role.SERVICE else {Emit, type(None)}
        if get_origin(hint) in {Union, UnionType}:
            messages = tuple(argument for argument in get_args(hint) if argument not in others)
            return Union[messages] if messages else _NOTHING  # noqa: UP007 - of as many as there are
        # Not `in`: one annotated with a dict has no hash.
        return _NOTHING if any(hint is item for item in others) else hint

    def message_parameter(self, endpoint: Endpoint) -> str:
        """Return the name of the parameter that takes the message.

        Raises:
            BridgeError: every one has a value.
        """
        name = self.first_unfilled(self.method(endpoint), endpoint.parameters)
        if name is None:
            text = f"{self.name} takes no message: every parameter has a value"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return name

    def first_unfilled(self, method: Any, given: Options) -> str | None:
        """Return the name of the parameter that takes the message: the first that nothing fills."""
        for parameter in self._parameters(method)[1 if self.is_class else 0 :]:
            positional = parameter.kind in {
                parameter.POSITIONAL_ONLY,
                parameter.POSITIONAL_OR_KEYWORD,
            }
            is_free = self.is_class or parameter.name not in given
            if positional and parameter.default is parameter.empty and is_free:
                return parameter.name
        return None

    def _parameters(self, method: Any) -> list[inspect.Parameter]:
        found = self._parameters_of.get(method) if inspect.isfunction(method) else None
        if found is None:
            found = list(signature(method).parameters.values())
            if inspect.isfunction(method):  # others may not be hashable, or new each time
                self._parameters_of[method] = found
        return found

    def _type_hints(self, method: Any) -> dict[str, Any]:
        """Return the hints of a callable, also of one whose class says how it is called."""
        while isinstance(method, partial):
            method = method.func
        has_own = inspect.isroutine(method) or inspect.isclass(method)
        report = method if has_own else type(method).__call__
        is_function = inspect.isfunction(report)  # others may not be hashable, or new each time
        found = self._hints_of.get(report) if is_function else None
        if found is None:
            found = read_hints(report, f"{self.name}: its type hints")
            if is_function:
                self._hints_of[report] = found
        return found

    def hints(self, method: Any) -> dict[str, Any]:
        """Return the hints of a callable; none where one cannot be read, for what is declared."""
        try:
            return self._type_hints(method)
        except HintError:
            return {}


def address_mistake(address: Sequence[str]) -> str:
    """Return what keeps an address from being `module:attribute`; "" where it is that."""
    name = address[0] if len(address) == 1 else ""
    module, colon, attribute = name.partition(":")
    is_file = module.startswith(".") or module.endswith(".py") or "/" in module
    if colon and module.strip() and attribute.strip() and not is_file:
        return ""
    text = f"expected one string 'module:attribute', got {list(address)}"
    if is_file:
        module = PurePath(module.lstrip(".")).stem
        return f"{text}; a module is named as `import` does, not as a file: {module!r}"
    module, dot, attribute = name.rpartition(".")
    return f"{text}; did you mean '{module}:{attribute}'?" if dot and not colon else text


def find(address: Sequence[str], modules: Modules) -> Target:
    """Import the object that an address names.

    Args:
        address: one string, `module:attribute`.
        modules: those of the bridge.

    Raises:
        BridgeError: NOT_FOUND for a module or attribute that is not there, UNAVAILABLE when a
            package that the module needs is not installed, RAISED for what its code raises,
            BAD_ENDPOINT for anything else.
    """
    wrong = address_mistake(address)
    if wrong:
        raise BridgeError(wrong, FailureReason.BAD_ENDPOINT)
    name = address[0]
    module_name, _, attribute = name.partition(":")
    owner: Any = None
    value: Any = _import(module_name, modules)
    for part in attribute.split("."):
        if not hasattr(value, part):
            hint = did_you_mean(part, dir(value))
            text = f"module {module_name!r} has no {attribute!r}{hint}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        owner, value = value, getattr(value, part)
    if inspect.isclass(owner) and inspect.isfunction(inspect.getattr_static(owner, part)):
        text = (
            f"{name} is a method, which needs an object: write {name.rpartition('.')[0]!r}, which "
            f"is built with the component's parameters; its __call__ takes the messages of an "
            f"`input`, and {part} those of an input of that name under `inputs`"
        )
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    if not callable(value):
        text = f"{name} is of type {type(value).__name__}: expected a function or a class"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    return Target(name, value)


def _is_open(hint: Any) -> bool:
    """Say whether a hint leaves open what a message is, such as `dict[str, Any]`."""
    if hint is Any or hint is object:
        return True
    is_container = get_origin(hint) in {list, dict, Union, UnionType}
    return is_container and any(map(_is_open, get_args(hint)))


def generates(method: Any) -> bool:
    return inspect.isgeneratorfunction(method) or inspect.isasyncgenfunction(method)


def _no_source(function: Any, hint: Any) -> str:
    """Return why what takes no message gives none, "" where it may."""
    if inspect.iscoroutinefunction(function):
        return "it takes no message and yields none: an `async def` that is a source yields"
    if hint is _NOTHING or _of_several(hint, iterables=True) is not hint:
        return ""
    return f"it takes no message and returns {getattr(hint, '__name__', hint)}, not an Iterator"


def _of_several(hint: Any, *, iterables: bool) -> Any:
    """Return the hint of one message, where a hint is of an iterator, or perhaps an iterable."""
    origin = get_origin(hint) or hint
    is_iterator = inspect.isclass(origin) and issubclass(origin, Iterator | AsyncIterator)
    if is_iterator or (iterables and origin in {Iterable, AsyncIterable}):
        return (*get_args(hint), _NOTHING)[0]
    return hint


def _import(name: str, modules: Modules) -> Any:
    try:
        return foreign(modules.load, name)
    except ModuleNotFoundError as error:
        missing = written_name(error.name or name)
        if name == missing or name.startswith(f"{missing}."):
            text = f"there is no module {name!r} (looked in {modules})"
            raise BridgeError(text, FailureReason.NOT_FOUND) from error
        text = f"module {name!r} needs the package {missing!r}, which is not installed"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    except ImportError as error:
        text = f"module {name!r}: {written_name(str(error))}{modules.place_of(error)}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    except UoarmError:
        raise
    except Exception as error:
        message = written_name(text_of(error))
        text = f"importing module {name!r} failed: {message}{modules.place_of(error)}"
        raise BridgeError(text, FailureReason.RAISED) from error
