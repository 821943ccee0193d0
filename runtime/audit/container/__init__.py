"""The log as a file: its bytes, its records and its summary, read strictly."""
