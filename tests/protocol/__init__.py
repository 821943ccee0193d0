"""Tests of everything that crosses the bus."""
