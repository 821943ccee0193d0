"""Tests of sessions in virtual time."""
