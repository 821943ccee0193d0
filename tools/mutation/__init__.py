"""Tests of the tests: which small mistakes in the deciding modules no test of theirs would find."""
