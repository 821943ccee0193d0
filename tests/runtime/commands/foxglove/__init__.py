"""What viewers are given, beside what Foxglove publishes of its messages."""
