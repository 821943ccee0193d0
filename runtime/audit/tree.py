"""The Merkle tree over every message of a log, in file order: RFC 6962, section 2.1.

    leaf = SHA-256(0x00 | covered)
    node = SHA-256(0x01 | left | right), where left has as many leaves as the largest power of two below the node's
    root of the empty tree = SHA-256 of nothing

``covered`` are the bytes that ``chain.py`` makes of a message. Size and root name everything in the log up to a record,
and no other log has them. What is kept of the leaves is the hashes of the complete subtrees, at most one for each
binary digit of their number.

That a leaf is one of a tree's is proven by the hashes beside its way up, from its sibling to the root's child (section
2.1.1): at most one for each binary digit of the tree's size. They are verified as RFC 9162, section 2.1.3.2, says.
"""

from collections.abc import Sequence
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
        return _above(self._complete) if self._complete else EMPTY


class ProvingTree(Tree):
    """A tree that remembers the inclusion proof of one of its leaves as it grows, and no more of the others.

    Attributes:
        index: of the leaf, from 0.
    """

    def __init__(self, index: int) -> None:
        super().__init__()
        self.index = index
        self._siblings: list[bytes] = []
        """Of the leaf and the nodes above it, within the complete subtree in which it lies."""

    def append(self, covered: bytes) -> None:
        """Add a leaf. Two subtrees of one size become one, and where the leaf is in one the other is its sibling."""
        node, place, height = leaf_hash(covered), self.size, 0
        while (place >> height) & 1:
            left, right = self._complete.pop(), node
            if self.index >> (height + 1) == place >> (height + 1):
                self._siblings.append(left if (self.index >> height) & 1 else right)
            node, height = node_hash(left, right), height + 1
        self._complete.append(node)
        self.size += 1

    @property
    def proof(self) -> tuple[bytes, ...]:
        """The hashes from the leaf's sibling to the root's child, 32 bytes each.

        Raises:
            ValueError: the tree has no such leaf yet.
        """
        if not self.index < self.size:
            raise ValueError(f"the tree has {self.size} leaves, none has the index {self.index}")
        # The complete subtrees are the binary digits of the size; the highest in which size and index differ holds it.
        height = (self.size ^ self.index).bit_length() - 1
        before = (self.size >> (height + 1)).bit_count()
        larger, smaller = self._complete[:before], self._complete[before + 1 :]
        behind = (_above(smaller),) if smaller else ()
        return (*self._siblings, *behind, *reversed(larger))


def _above(subtrees: Sequence[bytes]) -> bytes:
    """The node above complete subtrees, of which each has fewer leaves than the one before; at least one."""
    *larger, node = subtrees
    for left in reversed(larger):
        node = node_hash(left, node)
    return node


def root_of(leaf: bytes, index: int, size: int, proof: Sequence[bytes]) -> bytes | None:
    """The root that a tree has if this is an inclusion proof of one of its leaves.

    Args:
        leaf: the hash of the leaf, 32 bytes.
        index: of the leaf, from 0.
        size: leaves in the tree.
        proof: the hashes from the leaf's sibling to the root's child, 32 bytes each.

    Returns:
        None where no tree of this size has a leaf of this index, or where it takes more hashes or fewer.
    """
    if not 0 <= index < size:
        return None
    node, place, last = leaf, index, size - 1
    for beside in proof:
        if last == 0:
            return None
        if place & 1 or place == last:
            node = node_hash(beside, node)
            while not place & 1:  # the last of its level: it goes up unpaired, to where it is a right child
                place, last = place >> 1, last >> 1
        else:
            node = node_hash(node, beside)
        place, last = place >> 1, last >> 1
    return node if last == 0 else None
