"""Speech as a device: one service, one of two engines."""
