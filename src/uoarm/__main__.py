"""`python -m uoarm`."""

from uoarm.cli import main

main()
