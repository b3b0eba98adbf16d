"""A test of many values in one go: as a test each, every worker would collect all of them."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import pytest

T = TypeVar("T")
Test = Callable[..., None]


def for_all(
    name: str, values: Iterable[T], show: Callable[[T], object] = str
) -> Callable[[Test], Test]:
    """Run a test, which needs no fixture of its own for each, with all values of an argument.

    Args:
        name: of the argument.
        values: which it has in turn, none of them skipped as one fails.
        show: returns how one is named that fails.
    """
    taken = tuple(values)
    assert taken, f"there is no value of {name!r}"

    def sweep(test: Test) -> Test:
        @functools.wraps(test)
        def run(**given: Any) -> None:
            failed: dict[str, BaseException] = {}
            for value in taken:
                try:
                    test(**{name: value}, **given)
                # A skip would leave out the values behind it: a value that needs one is no sweep's.
                except (Exception, pytest.fail.Exception, pytest.skip.Exception) as error:  # noqa: BLE001
                    failed[str(show(value))] = error
            if failed:
                texts = (f"{value}: {error}" for value, error in failed.items())
                raise AssertionError("\n".join([f"it fails with {name}", *texts])) from next(
                    iter(failed.values())
                )

        signature = inspect.signature(test)
        parameters = [item for item in signature.parameters.values() if item.name != name]
        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return run

    return sweep
