"""The public interface as text: `python -m bench.interface > tests/docs/public_interface.txt`.

One line for each name that a public module lists in `__all__`, with the parameters of functions and
the members of classes, so that a change of the interface is a difference in a review. Annotations
are left out: they are written differently by different versions of Python.
"""

from __future__ import annotations

import enum
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from typing import get_origin

import attrs

import uoarm

# `cli` is commands, which docs/cli.md has.
_ELSEWHERE = {"uoarm.cli", "uoarm.__main__"}


def public_modules() -> list[str]:
    """Return the names of the package's public modules, without the package itself."""
    found = {f"uoarm.{module.name}" for module in pkgutil.iter_modules(uoarm.__path__)}
    return sorted(name for name in found if "._" not in name and name not in _ELSEWHERE)


def interface() -> Iterator[str]:
    """Yield the lines of the interface."""
    modules = {name: importlib.import_module(name) for name in public_modules()}
    elsewhere = {item for module in modules.values() for item in module.__all__}
    for name, module in {"uoarm": uoarm, **modules}.items():
        yield f"{name}:"
        for item in sorted(module.__all__):
            if module is uoarm and item in elsewhere:
                yield f"  {item}"  # described once, in the module of its own
            else:
                yield from _described(item, getattr(module, item))
        yield ""


def _described(name: str, value: object) -> Iterator[str]:
    # CPython 3.10 takes `Callable[[int], str]`, an alias, for a class.
    if inspect.isclass(value) and get_origin(value) is None:
        yield f"  class {name}{_bases(value)}"
        yield from (f"    {line}" for line in _members(value))
    elif inspect.isroutine(value):
        yield f"  {name}{_parameters(value)}"
    else:
        yield f"  {name}"


def _bases(kind: type) -> str:
    """Return the bases that are ours or builtins; a library's may differ with its version."""
    names = [
        base.__name__
        for base in kind.__bases__
        if base is not object and base.__module__.split(".")[0] in {"uoarm", "builtins", "enum"}
    ]
    return f"({', '.join(names)})" if names else ""


def _members(kind: type) -> list[str]:
    if issubclass(kind, enum.Enum):
        return list(kind.__members__)
    lines = []
    own = [base for base in kind.__mro__ if base.__module__.split(".")[0] == "uoarm"]
    if attrs.has(kind):
        lines += [
            f"{field.alias or field.name}{'' if field.default is attrs.NOTHING else '=…'}"
            for field in attrs.fields(kind)
            if not field.name.startswith("_")
        ]
    elif "__init__" in {name for base in own for name in vars(base)}:
        lines.append(f"__init__{_parameters(kind.__init__)}")
    fields = {line.removesuffix("=…") for line in lines}
    names = {name for base in own for name in vars(base)} - fields
    for name in sorted(name for name in names if not name.startswith("_")):
        member = inspect.getattr_static(kind, name)
        if isinstance(member, classmethod | staticmethod):
            member = member.__func__
        lines.append(f"{name}{_parameters(member)}" if inspect.isfunction(member) else name)
    return lines


def _parameters(function: object) -> str:
    try:
        signature = inspect.signature(function)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return "(…)"
    parameters = [
        parameter.replace(
            annotation=inspect.Parameter.empty,
            default=inspect.Parameter.empty
            if parameter.default is inspect.Parameter.empty
            else Ellipsis,
        )
        for parameter in signature.parameters.values()
    ]
    plain = signature.replace(parameters=parameters, return_annotation=inspect.Signature.empty)
    return str(plain).replace("Ellipsis", "…")


def main() -> None:
    """Print the interface."""
    print("\n".join(interface()).rstrip())


if __name__ == "__main__":
    main()
