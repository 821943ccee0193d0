"""What reads the system, and judges nothing."""
