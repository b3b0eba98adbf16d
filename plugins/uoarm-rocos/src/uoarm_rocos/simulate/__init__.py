"""Simulated devices that speak on a real line, for whoever has no hardware."""

from uoarm_rocos.simulate._blood_pressure import BloodPressureMonitor
from uoarm_rocos.simulate._ends import End, PtyEnd, TcpEnd
from uoarm_rocos.simulate._oximeter import FORMATS, Oximeter, Story
from uoarm_rocos.simulate._robot import Robot, robot_catalogue
from uoarm_rocos.simulate._run import Faults, Simulated, run
from uoarm_rocos.simulate._server import Job, Model, ProfileServer
from uoarm_rocos.simulate._vitals import Person, Vitals

__all__ = [
    "FORMATS",
    "BloodPressureMonitor",
    "End",
    "Faults",
    "Job",
    "Model",
    "Oximeter",
    "Person",
    "ProfileServer",
    "PtyEnd",
    "Robot",
    "Simulated",
    "Story",
    "TcpEnd",
    "Vitals",
    "robot_catalogue",
    "run",
]
