"""The parts of the warehouse's scene: which program each is, and what they need."""
