"""Simulated devices that speak on a real line, for whoever has no hardware."""

from uoarm_rocos.simulate._ends import End, PtyEnd, TcpEnd
from uoarm_rocos.simulate._robot import Robot, robot_catalogue
from uoarm_rocos.simulate._run import Faults, Simulated, run
from uoarm_rocos.simulate._server import Job, Model, ProfileServer

__all__ = [
    "End",
    "Faults",
    "Job",
    "Model",
    "ProfileServer",
    "PtyEnd",
    "Robot",
    "Simulated",
    "TcpEnd",
    "robot_catalogue",
    "run",
]
