"""What facts mean: pure, one judge for each kind of fact."""
