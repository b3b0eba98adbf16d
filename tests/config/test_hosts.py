"""Bridges on other machines, as a configuration names them."""

from __future__ import annotations

from ipaddress import IPv4Address, IPv6Address
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.config import inspect, load
from uoarm.model import Listening, place_problem

ROBOT = """
version: 1
{hosts}
bridges: {{far: {{plugin: python, host: {host}}}}}
functions:
  here: {{components: [{{name: one, bridge: far, service: {{endpoint: ["a:b"]}}}}]}}
"""
GOOD = 'hosts: {listen: "tls/192.0.2.1:7447", certificates: keys}'


def _write(folder: Path, host: str, hosts: str = GOOD) -> Path:
    file = folder / "robot.yaml"
    file.write_text(ROBOT.format(host=host, hosts=hosts))
    return file


def test_a_machine_is_read(tmp_path: Path) -> None:
    robot = load(_write(tmp_path, "{machine: arm, silence: 2}"))
    assert robot.hosts == Listening("tls/192.0.2.1:7447", str(tmp_path / "keys"), 3.0)
    far = robot.bridges["far"]
    assert far.host == {"machine": "arm", "silence": 2}
    assert "path" not in far.options  # the folder of this file is not that machine's


@pytest.mark.parametrize(
    ("host", "hosts", "says"),
    [
        ("{machine: arm}", "", "nothing says where this machine joins"),
        ("{machine: arm, python: /x}", GOOD, "python is settled on the machine itself"),
        ("{machine: arm, restarts: 3}", GOOD, "restarts is settled on the machine itself"),
        ("{machine: a/b}", GOOD, 'the name "a/b" is not allowed'),
        ("true", "hosts: {listen: 'tls/192.0.2.1:7447'}", "TLS needs certificates"),
        ("true", "hosts: {listen: 'tcp/192.0.2.1:7447'}", "without TLS only on loopback"),
        ("true", "hosts: {listen: 'udp/127.0.0.1:7447'}", "expected tls/ADDRESS:PORT"),
        ("true", "hosts: {certificates: keys}", 'the key "listen" is missing'),
        ("{environment: ../x}", GOOD, "expected text such as ros-jazzy"),
        ('{python: "/x\\0"}', GOOD, "expected text such as /opt/robot/bin/python"),
        ("true", 'hosts: {listen: "tls/192.0.2.1:7447", certificates: "k\\0"}', "such as cert"),
    ],
)
def test_mistakes_are_reported(tmp_path: Path, host: str, hosts: str, says: str) -> None:
    report = inspect(_write(tmp_path, host, hosts), missing=lambda _: "")
    assert report.robot is None
    assert [says in str(problem) for problem in report.problems].count(True) == 1


@pytest.mark.parametrize(
    "place",
    [
        "tls/192.0.2.1:1",
        "tls/robot.local:65535",
        "tls/[2001:db8::1]:7447",
        "tcp/127.1.2.3:80",
        "tcp/[::1]:80",
    ],
)
def test_places_where_machines_can_meet(place: str) -> None:
    assert place_problem(place) == ""


@pytest.mark.parametrize(
    "place",
    [
        "",
        "tls/a",
        "tls/a:0",
        "tls/a:65536",
        "tls/a:1#x=y",
        "tls/a b:1",
        "tcp/example.org:1",
        "tls/a:٣",
    ],
)
def test_places_where_they_cannot(place: str) -> None:
    assert place_problem(place)


@given(st.ip_addresses())
def test_without_tls_only_this_machine_can_be_met(address: IPv4Address | IPv6Address) -> None:
    text = f"[{address}]" if address.version == 6 else str(address)
    assert place_problem(f"tls/{text}:7447") == ""
    assert (place_problem(f"tcp/{text}:7447") == "") == address.is_loopback
