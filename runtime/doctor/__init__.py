"""Whether this machine can do what a session needs: probes read the system, judges say what it means.

Every probe reads, for a bounded time, and changes nothing; what it cannot know it says, and nobody takes that for good.
"""
