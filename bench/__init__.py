"""Benchmarks: `python -m bench` prints every table; nothing here is a test."""
