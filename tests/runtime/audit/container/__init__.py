"""Tests of runtime.audit.container."""
