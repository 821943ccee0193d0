"""Tests of what is there as a library."""
