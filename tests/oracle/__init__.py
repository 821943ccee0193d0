"""Independent reference mathematics: imports nothing of the packages under test."""
