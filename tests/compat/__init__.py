"""Tests: what earlier versions wrote is read."""
