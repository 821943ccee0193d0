"""What must hold for any bytes whatever, one module a family of parsers; see docs/fuzzing.md."""
