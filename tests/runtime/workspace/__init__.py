"""Tests of the planar workspace."""
