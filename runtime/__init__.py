"""The runtime that decides whether a robot may start to cut."""
