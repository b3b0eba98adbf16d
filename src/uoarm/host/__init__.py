"""Bridge hosts: a bridge, unchanged, in a process and Python environment of its own."""
