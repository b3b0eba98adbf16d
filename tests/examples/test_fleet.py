"""The vehicles deliver every box, although one of them is killed on the way."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from itertools import islice
from pathlib import Path

from tests.processes import (
    hold_dies_whole,
    hold_ends_all,
    hold_ends_unread,
    processes_of,
    run_python,
)

from uoarm.testing import free_port, patience

DESK = Path(__file__).parents[2] / "examples" / "fleet" / "desk.py"


def test_every_box_arrives_although_a_vehicle_is_killed() -> None:
    ports = [str(free_port()) for _ in range(3)]
    done = run_python(DESK, *ports)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all 12 boxes have arrived" in done.stdout
    assert "cat is killed" in done.stdout
    boxes = re.findall(r"has delivered (box \d+)", done.stdout)
    assert {*boxes} == {f"box {number}" for number in range(1, 13)}


def test_vehicles_that_were_out_of_reach_go_on() -> None:
    command = [sys.executable, "-u", str(DESK), *(str(free_port()) for _ in range(3))]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as desk:
        try:
            assert desk.stdout is not None
            assert any("has delivered" in line for line in desk.stdout)
            vehicles = [process for process in processes_of(desk.pid) if process != desk.pid]
            for vehicle in vehicles:
                os.kill(vehicle, signal.SIGSTOP)
            lost = list(islice((line for line in desk.stdout if " is lost " in line), 3))
            for vehicle in vehicles:
                os.kill(vehicle, signal.SIGCONT)
            rest, _ = desk.communicate(timeout=2 * patience())
        finally:
            with suppress(ProcessLookupError):
                os.killpg(desk.pid, signal.SIGKILL)
    assert len({line.partition(" ")[0] for line in lost}) == 3
    assert rest.endswith("all 12 boxes have arrived\n")


def test_a_server_that_has_taken_a_port_is_no_vehicle() -> None:
    port = str(free_port())
    done = run_python(DESK, port, port, str(free_port()))
    assert done.returncode == 1, done.stdout
    assert done.stderr.endswith(
        f"the vehicle at port {port} has ended: desk.py PORT PORT PORT takes other ports\n"
    )


def test_what_are_no_three_ports_is_refused() -> None:
    for ports in (("9410",), ("a", "b", "c")):
        done = run_python(DESK, *ports)
        assert done.returncode == 1
        assert done.stderr == f"usage: desk.py [PORT PORT PORT], not {' '.join(ports)}\n"


def test_a_signal_ends_every_vehicle() -> None:
    hold_ends_all(sys.executable, str(DESK), *(str(free_port()) for _ in range(3)))


def test_it_ends_with_what_reads_it() -> None:
    hold_ends_unread(sys.executable, str(DESK), *(str(free_port()) for _ in range(3)))


def test_no_vehicle_outlives_the_desk() -> None:
    ports = (str(free_port()) for _ in range(3))
    hold_dies_whole(sys.executable, str(DESK), *ports, after="has delivered")
