"""The whole story in one go: two sessions, each part in a process of its own."""
