"""Type hints as message structures, and messages as the values that hints say, both ways."""
