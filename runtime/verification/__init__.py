"""Decides for every point of a path whether it keeps its deadbands."""
