"""Python reads this as it starts in a server of the tests: it waits for its clients as they do.

A server cuts off who gives no sign of life for a while. Here the client is only starved.
"""

import importlib.util
import os
from pathlib import Path

patience = float(os.environ["UOARM_TEST_PATIENCE"])
file = Path(__file__).parents[2] / "harness" / "_limits.py"
spec = importlib.util.spec_from_file_location("limits_of_tests", file)
assert spec is not None
assert spec.loader is not None
limits = importlib.util.module_from_spec(spec)
spec.loader.exec_module(limits)
limits.LongLimits(patience).install()
