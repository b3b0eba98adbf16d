"""What the command `uoarm-rocos` begins with: Ctrl-C ends it in silence while it still imports."""

from _uoarm_command import run  # type: ignore[import-untyped]  # one module has no py.typed


def main() -> None:
    """Run the command."""
    run("uoarm_rocos._command")
