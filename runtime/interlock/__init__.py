"""The interlock: which preconditions must hold, and the one table that decides."""
