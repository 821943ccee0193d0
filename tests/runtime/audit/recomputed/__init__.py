"""Tests of runtime.audit.recomputed."""
