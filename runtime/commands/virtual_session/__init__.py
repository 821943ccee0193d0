"""A session of our runtime in virtual time, for tests of a controller (docs/hil.md)."""
