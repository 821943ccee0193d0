"""Registrations that other programs wrote, one reader a format, to the transform and to ``registration.json``."""
