"""Everything that crosses the bus, and what both sides share."""
