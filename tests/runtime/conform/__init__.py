"""Tests of the negative suite."""
