"""A sweep fails with each value that fails, by name, and takes fixtures and further sweeps."""

from __future__ import annotations

import inspect

import pytest
from tests.sweeps import for_all


def test_every_value_is_tried_and_those_that_fail_are_named() -> None:
    tried = []

    @for_all("number", range(4))
    @for_all("sign", (1, -1))
    def test(number: int, sign: int, other: str) -> None:
        tried.append(number * sign)
        assert (number, sign) not in {(1, -1), (3, 1)}, other

    assert [*inspect.signature(test).parameters] == ["other"]
    with pytest.raises(AssertionError) as caught:
        test(other="a fixture")
    assert tried == [0, 0, 1, -1, 2, -2, 3, -3]
    lines = str(caught.value).splitlines()
    assert [line for line in lines if "it fails with" in line or "a fixture" in line] == [
        "it fails with number",
        "1: it fails with sign",
        "-1: a fixture",
        "3: it fails with sign",
        "1: a fixture",
    ]


def test_a_skip_is_a_failure_as_the_values_behind_it_would_not_be_tried() -> None:
    @for_all("number", range(2))
    def test(number: int) -> None:
        if not number:
            pytest.skip("there is none")

    with pytest.raises(AssertionError, match="0: there is none"):
        test()


def test_no_value_is_a_mistake() -> None:
    with pytest.raises(AssertionError, match="no value of 'page'"):
        for_all("page", [])
