"""The Merkle tree over every message of a log, in file order: RFC 6962, section 2.1.

    leaf = SHA-256(0x00 | covered)
    node = SHA-256(0x01 | left | right), where left has as many leaves as the largest power of two below the node's
    root of the empty tree = SHA-256 of nothing

``covered`` are the bytes that ``chain.py`` makes of a message. Size and root name everything in the log up to a record,
and no other log has them. What is kept of the leaves is the hashes of the complete subtrees, at most one for each
binary digit of their number.
"""

from hashlib import sha256
from typing import Final

EMPTY: Final = sha256().digest()
"""The root of the empty tree."""


def leaf_hash(covered: bytes) -> bytes:
    """The hash of a leaf, 32 bytes."""
    return sha256(b"\0" + covered).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    """The hash of a node above these two, 32 bytes."""
    return sha256(b"\1" + left + right).digest()


class Tree:
    """The tree of the leaves so far.

    Attributes:
        size: how many.
    """

    def __init__(self) -> None:
        self.size = 0
        self._complete: list[bytes] = []
        """From the left, each with fewer leaves than the one before: a binary digit 1 of the size each."""

    def append(self, covered: bytes) -> None:
        """Add a leaf; two complete subtrees of one size become one."""
        node, digits = leaf_hash(covered), self.size
        while digits & 1:
            node, digits = node_hash(self._complete.pop(), node), digits >> 1
        self._complete.append(node)
        self.size += 1

    @property
    def root(self) -> bytes:
        """The root, 32 bytes."""
        if not self._complete:
            return EMPTY
        *larger, root = self._complete
        for left in reversed(larger):
            root = node_hash(left, root)
        return root
