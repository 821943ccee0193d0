"""The exact planar workspace of the arm and the distance to its boundary."""
