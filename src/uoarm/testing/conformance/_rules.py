"""Rules: what a test of the suite holds, and where the page says so."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import pytest

__all__ = ["PAGE", "rule_of", "rules"]

PAGE = "docs/writing-a-bridge.md"

T = TypeVar("T")


def rules(section: str) -> Callable[[type[T]], type[T]]:
    """Have the failures of a class of tests name the endpoint, the rule and its section.

    A test's name is its rule.

    Args:
        section: anchor on the page on writing bridges.
    """

    def mark(tests: type[T]) -> type[T]:
        for name, test in list(vars(tests).items()):
            if name.startswith("test_"):
                setattr(tests, name, _naming(test, section))
        return tests

    return mark


def rule_of(test: Callable[..., None]) -> str:
    """Return the rule that a test holds, as a sentence."""
    return test.__name__.removeprefix("test_").replace("_", " ")


def _naming(test: Callable[..., None], section: str) -> Callable[..., None]:
    @functools.wraps(test)
    def run(*given: Any, **named: Any) -> None:
        try:
            test(*given, **named)
        except (Exception, pytest.fail.Exception) as error:
            text = f"{_place(named)}: the rule is: {rule_of(test)} ({PAGE}#{section})"
            raise AssertionError(f"{text}\n{error}") from error

    return run


def _place(named: dict[str, Any]) -> str:
    """Say what a test was about, as far as its arguments say so."""
    if "served" in named:
        return str(named["served"].endpoint)
    if "kind" in named:
        pair = named["world"].pair(named["kind"])
        return f"{pair.sink} to {pair.source}"
    return f"bridge {named['bridge'].name!r}" if "bridge" in named else "the bridge"
