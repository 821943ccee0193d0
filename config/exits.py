"""Exit codes that mean the same for every command and program; 1 is each command's own."""

OK = 0
REFUSED = 2
"""An input file, an option or the bus was refused."""
STOPPED = 3
"""``run``: stopped, by a person or a fault."""
INTERNAL = 70
NOT_WRITTEN = 74
"""What was to be written does not fit where it was to go: no verdict's code may be given."""
INTERRUPTED = 130
SIGNALLED = 128
"""And the signal's number: ended by it, in order, as a shell says of a program that it has ended."""
READER_GONE = 141
"""Whoever was to read the result has gone: no verdict's code may be given, as by a program that SIGPIPE ends."""
