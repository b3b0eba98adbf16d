"""Parameters between clients: set, read by others, deleted, and bounded together."""

from __future__ import annotations

import json

import pytest
from ros import Enter
from uoarm_rosbridge._hub import Parameters

from uoarm.server.front_end import LimitError

OWNER = "one"


def test_what_one_client_sets_another_reads(enter: Enter) -> None:
    setter, reader = enter(), enter()
    value = json.dumps({"gains": [1, 2.5]})
    assert setter.call("/rosapi/set_param", {"name": "drive", "value": value})["successful"]
    assert reader.call("/rosapi/get_param", {"name": "/drive"})["value"] == value
    assert reader.call("/rosapi/has_param", {"name": "drive"}) == {"exists": True}
    assert reader.call("/rosapi/get_param_names") == {"names": ["/drive"]}
    assert reader.call("/rosapi/delete_param", {"name": "drive"})["successful"]
    assert not reader.call("/rosapi/delete_param", {"name": "drive"})["successful"]
    assert setter.call("/rosapi/has_param", {"name": "drive"}) == {"exists": False}


def test_what_was_never_set_is_null_or_has_the_default(enter: Enter) -> None:
    client = enter()
    absent = client.call("/rosapi/get_param", {"name": "x"})
    assert (absent["value"], absent["successful"]) == ("null", False)
    assert client.call("/rosapi/get_param", {"name": "x", "default": "7"})["value"] == "7"


def test_there_may_be_so_many_and_no_more() -> None:
    parameters = Parameters()
    for number in range(1_000):
        parameters.set(f"/{number}", "1", OWNER)
    with pytest.raises(LimitError, match="1,000 parameters"):
        parameters.set("/more", "1", OWNER)
    parameters.set("/7", "2", OWNER)
    assert parameters.delete("/8")
    parameters.set("/more", "1", OWNER)


def test_together_they_have_so_much_and_no_more() -> None:
    parameters = Parameters()
    half = json.dumps("x" * 500_000)
    parameters.set("/a", half, OWNER)
    parameters.set("/b", half, OWNER)
    with pytest.raises(LimitError, match="1,048,576 octets"):
        parameters.set("/c", half, OWNER)
    parameters.set("/a", half, OWNER)
    parameters.set("/a", "1", OWNER)
    parameters.set("/c", half, OWNER)
    assert parameters.names == ["/a", "/b", "/c"]


def test_who_has_less_than_an_equal_share_may_set_one_still() -> None:
    parameters = Parameters()
    for number in range(1_000):
        parameters.set(f"/{number}", "1", OWNER)
    for number in range(500):
        parameters.set(f"/other/{number}", json.dumps("x" * 1_000), "other")
    with pytest.raises(LimitError, match="1,000 parameters"):
        parameters.set("/other/more", "1", "other")
    for number in range(500):
        assert parameters.delete(f"/other/{number}")
    parameters.set("/other/more", "1", "other")
