"""Certificates for bridge hosts on other machines: a small authority of the robot's own.

A folder holds the authority (`ca.pem`, `ca.key`) and for every name `NAME.pem` and `NAME.key`.
The manager's certificate is good for listening only, a machine's for joining only, so that no
machine can stand in for the manager.

Needs the extra `uoarm[certificates]`.
"""

from uoarm._certificates._authority import MANAGER, Authority

__all__ = ["MANAGER", "Authority"]
