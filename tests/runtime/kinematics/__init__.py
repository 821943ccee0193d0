"""Tests of the kinematics."""
