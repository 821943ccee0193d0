"""Every communication error against every message, every identifier, every key: injected into both real loops."""
