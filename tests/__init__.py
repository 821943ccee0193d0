"""Tests."""

from hypothesis import settings

# No test depends on how fast the machine is: a test that hangs is ended by pytest-timeout.
settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")
