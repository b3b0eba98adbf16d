"""Components in plain Python: one for each framework's vehicles, and those of the application."""
