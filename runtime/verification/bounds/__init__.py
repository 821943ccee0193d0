"""Bounds of every quantity over whole intervals of a path, and how they are refined."""
