"""The station at the docks: a scale and a lamp on a serial line."""
