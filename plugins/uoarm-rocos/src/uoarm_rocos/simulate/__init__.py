"""Simulated devices that speak on a real line, for work without hardware."""

from uoarm_rocos.simulate._patient import (
    FORMATS,
    BloodPressureMonitor,
    Oximeter,
    Person,
    Scenario,
    VitalSigns,
)
from uoarm_rocos.simulate._run import LineEnd, LineFaults, PtyEnd, Simulated, TcpEnd, run
from uoarm_rocos.simulate._server import Job, Model, ProfileServer, SimulatedRobot, robot_catalogue

__all__ = [
    "FORMATS",
    "BloodPressureMonitor",
    "Job",
    "LineEnd",
    "LineFaults",
    "Model",
    "Oximeter",
    "Person",
    "ProfileServer",
    "PtyEnd",
    "Scenario",
    "Simulated",
    "SimulatedRobot",
    "TcpEnd",
    "VitalSigns",
    "robot_catalogue",
    "run",
]
