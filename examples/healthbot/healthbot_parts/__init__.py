"""Components of the HealthBot in plain Python: the recogniser, and spares of lower priority."""
