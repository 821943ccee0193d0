"""Tests of registrations that other programs wrote."""
