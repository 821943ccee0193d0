"""Whole sessions: real processes over the project's own virtual bus."""
