"""Fixtures for hardware-in-the-loop tests."""
