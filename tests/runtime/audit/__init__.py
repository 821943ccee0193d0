"""Tests of runtime.audit."""
