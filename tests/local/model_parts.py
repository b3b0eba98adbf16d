"""A component whose messages are models of pydantic."""

from __future__ import annotations

from pydantic import BaseModel, Field
from tests.local.typed_parts import Mode


class Order(BaseModel):
    amount: int = Field(ge=0)
    mode: Mode = Mode.FAST


def ask_order(order: Order) -> Order:
    assert type(order) is Order
    return Order(amount=order.amount + 1, mode=order.mode)
