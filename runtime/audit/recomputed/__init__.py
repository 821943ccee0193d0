"""What a session decided, decided again from its log: inputs, verdict, approach, and what was enabled on them."""
