"""What is said of a verdict: sentences for people, one line, one JSON document."""
