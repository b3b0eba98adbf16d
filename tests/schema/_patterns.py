"""Patterns that generated schemas use, each with strings in and around its language."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SAMPLES: Mapping[str, Sequence[str]] = {
    "^a": ("a", "ab", "aa", "b", "ba", ""),
    "a$": ("a", "ba", "a\n", "ab"),
    "^a$": ("a", "a\n", "aa", ""),
    "^[a-c]$": ("a", "b", "c", "d", "C"),
    "^[a-z]+$": ("a", "b", "zz", "abc", "A", ""),
    "^[a-z]{2,4}$": ("ab", "abcd", "abcde", "a", "aB"),
    "^(a|b)*$": ("", "a", "b", "ab", "abc"),
    "^\\d+$": ("0", "12", "007", "\u0663", ""),
    "^[0-9]{1,3}$": ("0", "12", "123", "1234"),
    "^\\w*$": ("", "a_1", "\u00e9", "-"),
    "^.$": ("a", "\n", "\u2028", "\U0001f600", "ab"),
    "^[^a]*$": ("", "b", "a", "\n", "bab"),
    "b": ("b", "abc", "a", ""),
    "^x-": ("x-", "x-a", "x", "a"),
    "^(|a)$": ("", "a", "b"),
    "^(?!a)": ("", "b", "a", "ab", "ba"),
    "^(?=.*b)[a-c]+$": ("b", "ab", "ac", "abc", ""),
    "\\bab\\b": ("ab", "ab a", "a", "aab", "-ab-"),
    "\\S": ("a", " ", "", " a"),
}
