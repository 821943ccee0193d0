"""Tests of set-up: the locks, the environment that make makes, the wheel."""
