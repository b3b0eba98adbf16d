"""`python -m uoarm`."""

from _uoarm_command import main

main()
