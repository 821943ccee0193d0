"""Tests of plans, tool paths and registrations."""
