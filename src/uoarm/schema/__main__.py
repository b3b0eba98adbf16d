"""`python -m uoarm.schema check A.json B.json`."""

from uoarm.schema._command import schema

schema(prog_name="python -m uoarm.schema")
