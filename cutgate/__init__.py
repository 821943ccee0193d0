"""Pre-cut safety interlock for a bone-milling robot: proves a cut path before it may start.

The packages are links to the repository's top level, so that each has one place and one name, ``cutgate.runtime``.
"""

__version__ = "0.2.0a1"
