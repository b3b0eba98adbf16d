"""The parts of the HealthBot scene, and what starts and watches them."""
