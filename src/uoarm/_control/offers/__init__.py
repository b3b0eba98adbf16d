"""Functions that the configuration puts on offer in a framework."""
