"""Drivers of devices that speak their makers' frames."""
