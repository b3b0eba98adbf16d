"""A short search in every decoder, the same each time; `make fuzz` searches for longer."""

from __future__ import annotations

import pytest
from hypothesis import given, target
from hypothesis import strategies as st
from tests.fuzz.targets import TARGETS
from tests.sweeps import for_all

_PIECES = st.binary(max_size=8) | st.sampled_from(
    [b'"', b"[", b"]", b"{", b"}", b",", b"\\", b"\x9f", b"\xff", b"\xd8\x28", b"\xdd", b"NaN"]
)


@st.composite
def inputs(draw: st.DrawFn, seeds: tuple[bytes, ...]) -> bytes:
    """Return an input from which pieces were cut, and into which others were put."""
    data = draw(st.sampled_from(seeds) | st.binary(max_size=64))
    for _ in range(draw(st.integers(0, 4))):
        start = draw(st.integers(0, len(data)))
        end = draw(st.integers(start, min(len(data), start + 4)))
        data = data[:start] + draw(_PIECES) + data[end:]
    return data


@pytest.mark.parametrize("name", TARGETS)
def test_anything_is_read_or_refused(name: str) -> None:
    one = TARGETS[name]

    @given(inputs(one.seeds))
    def search(data: bytes) -> None:
        target(float(one.run(data)))

    search()


@for_all("name", TARGETS)
def test_a_decoder_takes_one_of_its_seeds(name: str) -> None:
    """Or the search begins from nothing."""
    assert any(TARGETS[name].run(seed) for seed in TARGETS[name].seeds)
