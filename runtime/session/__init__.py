"""One session: bus, clock, disk and worker wired to the interlock."""
