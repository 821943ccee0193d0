"""Input files to poses: plans, tool paths and registrations."""
