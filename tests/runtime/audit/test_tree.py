"""The tree of a log: RFC 6962's own numbers, its definition written again, and memory that does not grow with the log."""

import hashlib

from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit.tree import EMPTY, Tree, leaf_hash, node_hash

LEAVES = tuple(
    bytes.fromhex(leaf)
    for leaf in (
        "",
        "00",
        "10",
        "2021",
        "3031",
        "40414243",
        "5051525354555657",
        "606162636465666768696a6b6c6d6e6f",
    )
)
ROOTS = (
    "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
    "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
    "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
    "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
    "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
)
"""The vectors of Certificate Transparency's reference implementation (merkle_tree_test.cc): the roots of the first 0 to
8 of its leaves."""


def tree_of(leaves):
    tree = Tree()
    for leaf in leaves:
        tree.append(leaf)
    return tree


def definition(leaves):
    """RFC 6962, section 2.1, word by word: k is the largest power of two smaller than n."""
    n = len(leaves)
    if n == 0:
        return hashlib.sha256(b"").digest()
    if n == 1:
        return hashlib.sha256(b"\x00" + leaves[0]).digest()
    k = max(2**power for power in range(n) if 2**power < n)
    return hashlib.sha256(b"\x01" + definition(leaves[:k]) + definition(leaves[k:])).digest()


def test_the_known_vectors():
    for size, root in enumerate(ROOTS):
        tree = tree_of(LEAVES[:size])
        assert (tree.size, tree.root.hex()) == (size, root)
        assert definition(LEAVES[:size]).hex() == root


def test_the_empty_tree():
    assert Tree().root == EMPTY == hashlib.sha256(b"").digest()
    assert Tree().size == 0


def test_a_leaf_is_never_a_node():
    left, right = leaf_hash(b"a"), leaf_hash(b"b")
    assert leaf_hash(left + right) != node_hash(left, right) == tree_of([b"a", b"b"]).root


@given(st.integers(0, 700), st.binary(max_size=8))
def test_the_definition_at_any_size(size, salt):
    leaves = [salt + number.to_bytes(2) for number in range(size)]
    assert tree_of(leaves).root == definition(leaves)


@given(st.lists(st.binary(max_size=4), max_size=70))
def test_the_definition_at_every_size_on_the_way(leaves):
    tree = Tree()
    for size, leaf in enumerate(leaves):
        assert (tree.size, tree.root) == (size, definition(leaves[:size]))
        tree.append(leaf)


@given(st.lists(st.binary(max_size=4), min_size=1, max_size=40), st.data())
def test_every_leaf_and_its_place_count(leaves, draws):
    place = draws.draw(st.integers(0, len(leaves) - 1))
    other = draws.draw(st.binary(max_size=4))
    changed = [*leaves[:place], other, *leaves[place + 1 :]]
    assert (tree_of(changed).root == tree_of(leaves).root) == (changed == leaves)


def test_asking_for_the_root_changes_nothing():
    tree = tree_of(LEAVES[:7])
    assert tree.root == tree.root
    tree.append(LEAVES[7])
    assert tree.root.hex() == ROOTS[8]


def test_memory_goes_by_the_digits_of_the_size():
    tree = Tree()
    for number in range(3000):
        tree.append(b"")
        assert len(tree._complete) == (number + 1).bit_count()
