"""Tests of runtime.session: whole sessions in virtual time, against the simulated controller."""
