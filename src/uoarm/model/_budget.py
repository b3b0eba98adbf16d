"""What one message that enters may cost, and what it has cost so far."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from attrs import field, frozen
from attrs.validators import ge

from uoarm.errors import ControlMessageError

__all__ = ["Budget", "Spending"]


@frozen
class Budget:
    """Bounds of one message, held by every decoder before it does the work.

    A decoder that counts a value twice or too generously refuses early, never late.

    Attributes:
        octets: of the message as it comes.
        elements: values and names of members, however deep they lie; octets and a typed array are
            one each.
        depth: levels of nested lists and objects.
        dimensions: of one array that says how many it has.
    """

    octets: int = field(default=16_777_216, validator=ge(1))
    elements: int = field(default=500_000, validator=ge(1))
    depth: int = field(default=64, validator=ge(1))
    dimensions: int = field(default=8, validator=ge(1))


class Spending:
    """How much of a budget one message has used; one decoder's at a time.

    Each method raises ControlMessageError when the budget does not allow it.

    Attributes:
        budget: what it may cost.
        elements: counted so far; never fewer than there are.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget = budget
        self.elements = 0

    def octets(self, count: int) -> None:
        """Check the length of the message as it comes."""
        if count > self.budget.octets:
            allowed = f"{self.budget.octets:,} are allowed"
            raise ControlMessageError(f"it has {count:,} bytes; {allowed}")

    def add(self, elements: int) -> None:
        """Count elements that are about to be made."""
        self.elements += elements
        if self.elements > self.budget.elements:
            raise ControlMessageError(f"it holds more than {self.budget.elements:,} values")

    def depth(self, levels: int) -> None:
        """Check how deep it is nested."""
        if levels > self.budget.depth:
            raise ControlMessageError(f"nested more than {self.budget.depth} levels deep")

    def dimensions(self, sizes: Sequence[Any], items: int) -> None:
        """Check the sizes that an array of several dimensions claims, and count its rows.

        Done so that no product is taken of numbers that nothing in the message stands for.

        Args:
            sizes: one for each dimension, the outermost first.
            items: how many values the array has.
        """
        if not 1 <= len(sizes) <= self.budget.dimensions:
            most = self.budget.dimensions
            raise ControlMessageError(f"{len(sizes):,} dimensions; 1 to {most} are allowed")
        count = 1
        rows = 0
        for size in sizes:
            rows += count
            if type(size) is not int or not 1 <= size <= items:
                raise ControlMessageError(
                    f"dimensions must be whole numbers from 1 to the {items:,} items that came"
                )
            count *= size
            if count > items:
                break
        if count != items:
            raise ControlMessageError(f"the dimensions do not hold the {items:,} items that came")
        self.add(rows + items)
