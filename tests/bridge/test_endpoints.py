"""What a bridge finds wrong with an endpoint is reported with the endpoint's name."""

from __future__ import annotations

import pytest

from uoarm.bridge import reading_endpoint
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Role

ENDPOINT = Endpoint("ros", "camera", Role.OUTPUT, ("/image",))


def test_a_wrong_address_names_bridge_and_endpoint() -> None:
    with pytest.raises(BridgeError) as caught, reading_endpoint(ENDPOINT):
        raise ValueError("expected [name, type]")
    assert str(caught.value) == f"bridge 'ros': {ENDPOINT}: expected [name, type]"
    assert caught.value.reason is FailureReason.BAD_ENDPOINT
    assert caught.value.__suppress_context__


def test_whatever_else_is_raised_passes() -> None:
    with pytest.raises(OSError, match="unplugged"), reading_endpoint(ENDPOINT):
        raise OSError("unplugged")
