"""What all tests have in common, those of the plugins, too: see tests/harness."""

pytest_plugins = ["pytester", "tests.harness"]
