"""The manager's side of a host on this machine: it starts, watches and ends the process."""
