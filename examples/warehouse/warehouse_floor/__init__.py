"""The floor: where everything stands, and a simulator of the vehicles' bodies."""
