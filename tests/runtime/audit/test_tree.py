"""The tree of a log: RFC 6962's own numbers, its definition written again, and memory that does not grow with the log."""

import hashlib
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymerkle import InmemoryTree, verify_inclusion

from cutgate.runtime.audit.tree import EMPTY, ProvingTree, Tree, leaf_hash, node_hash, root_of

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

PATHS = {
    (0, 1): (),
    (0, 2): ("96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7",),
    (1, 2): ("6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",),
    (2, 3): ("fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",),
    (1, 5): (
        "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
        "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e",
        "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b",
    ),
    (0, 8): (
        "96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7",
        "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e",
        "6b47aaf29ee3c2af9af889bc1fb9254dabd31177f16232dd6aab035ca39bf6e4",
    ),
    (5, 8): (
        "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b",
        "ca854ea128ed050b41b35ffc1b87b8eb2bde461e9e3b5596ece6b9d5975a0ae0",
        "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    ),
}
"""Index and size, and the inclusion proof, by the same implementation."""


def tree_of(leaves, tree=None):
    tree = tree or Tree()
    for leaf in leaves:
        tree.append(leaf)
    return tree


def leaves_of(size, salt=b""):
    return [salt + number.to_bytes(4) for number in range(size)]


def definition(leaves):
    """RFC 6962, section 2.1, word by word: k is the largest power of two smaller than n."""
    n = len(leaves)
    if n == 0:
        return hashlib.sha256(b"").digest()
    if n == 1:
        return hashlib.sha256(b"\x00" + leaves[0]).digest()
    k = max(2**power for power in range(n) if 2**power < n)
    return hashlib.sha256(b"\x01" + definition(leaves[:k]) + definition(leaves[k:])).digest()


def path(index, leaves):
    """RFC 6962, section 2.1.1, word by word."""
    n = len(leaves)
    if n == 1:
        return []
    k = max(2**power for power in range(n) if 2**power < n)
    if index < k:
        return [*path(index, leaves[:k]), definition(leaves[k:])]
    return [*path(index - k, leaves[k:]), definition(leaves[:k])]


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


# ---------------------------------------------------------------- inclusion proofs


def test_the_known_proofs():
    for (index, size), hashes in PATHS.items():
        proof = tree_of(LEAVES[:size], ProvingTree(index)).proof
        assert tuple(one.hex() for one in proof) == hashes
        assert root_of(leaf_hash(LEAVES[index]), index, size, proof).hex() == ROOTS[size]


@pytest.mark.parametrize("size", range(1, 34))
def test_every_leaf_of_every_small_tree(size):
    leaves = leaves_of(size)
    for index in range(size):
        tree = tree_of(leaves, ProvingTree(index))
        assert tree.root == definition(leaves)
        assert list(tree.proof) == path(index, leaves)
        assert root_of(leaf_hash(leaves[index]), index, size, tree.proof) == tree.root


@given(st.integers(1, 300).flatmap(lambda size: st.tuples(st.integers(0, size - 1), st.just(size))))
def test_a_proof_is_the_definitions(place):
    index, size = place
    leaves = leaves_of(size)
    tree = tree_of(leaves, ProvingTree(index))
    assert list(tree.proof) == path(index, leaves)


@given(st.integers(0, 40), st.integers(1, 40))
def test_a_proof_grows_with_the_tree(index, more):
    tree, leaves = ProvingTree(index), leaves_of(index + more)
    for size, leaf in enumerate(leaves):
        if size > index:
            assert list(tree.proof) == path(index, leaves[:size])
        else:
            with pytest.raises(ValueError, match=f"the tree has {size} leaves, none has the index {index}"):
                _ = tree.proof
        tree.append(leaf)


@given(
    st.integers(1, 200).flatmap(lambda size: st.tuples(st.integers(0, size - 1), st.just(size))),
    st.integers(0, 250),
    st.integers(0, 250),
)
def test_a_proof_shows_no_other_leaf_place_or_size(place, other_index, other_size):
    index, size = place
    leaves = leaves_of(size)
    tree = tree_of(leaves, ProvingTree(index))
    shown = root_of(leaf_hash(leaves[index]), other_index, other_size, tree.proof)
    if other_index != index:
        assert shown != tree.root
    assert root_of(leaf_hash(b"other"), index, size, tree.proof) != tree.root


@given(st.integers(1, 200).flatmap(lambda size: st.tuples(st.integers(0, size - 1), st.just(size))))
def test_a_proof_that_is_too_long_or_too_short_shows_nothing(place):
    index, size = place
    tree = tree_of(leaves_of(size), ProvingTree(index))
    leaf, proof = leaf_hash(leaves_of(size)[index]), tree.proof
    assert root_of(leaf, index, size, (*proof, bytes(32))) is None
    assert root_of(leaf, index, size, (bytes(32), *proof)) is None
    assert root_of(leaf, index, size, (*proof, *proof, bytes(32))) is None
    for end in range(len(proof)):
        assert root_of(leaf, index, size, proof[:end]) is None


@given(
    st.integers(2, 200).flatmap(lambda size: st.tuples(st.integers(0, size - 1), st.just(size))), st.data()
)
def test_every_hash_of_a_proof_counts(place, draws):
    index, size = place
    leaves = leaves_of(size)
    tree = tree_of(leaves, ProvingTree(index))
    proof = list(tree.proof)
    number = draws.draw(st.integers(0, len(proof) - 1))
    proof[number] = bytes((proof[number][0] ^ 1, *proof[number][1:]))
    assert root_of(leaf_hash(leaves[index]), index, size, proof) not in (None, tree.root)


@pytest.mark.parametrize(("index", "size"), [(0, 0), (1, 1), (-1, 1), (8, 8), (0, -1), (-1, 0)])
def test_no_tree_has_such_a_leaf(index, size):
    assert root_of(leaf_hash(b""), index, size, ()) is None


def test_the_one_leaf_is_the_root():
    assert root_of(leaf_hash(b"a"), 0, 1, ()) == tree_of([b"a"]).root == leaf_hash(b"a")


@pytest.mark.no_cover
def test_a_proof_takes_the_memory_of_its_hashes():
    """A hundred thousand leaves, of which a list of hashes alone would take 6 MB."""
    tree = ProvingTree(77_777)
    tracemalloc.start()
    for number in range(100_000):
        tree.append(number.to_bytes(4))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(tree.proof) == 17
    assert peak < 20_000


# ---------------------------------------------------------------- another implementation


@given(st.integers(1, 130), st.binary(max_size=4), st.data())
def test_pymerkle_has_the_same_roots_and_proofs(size, salt, draws):
    index = draws.draw(st.integers(0, size - 1))
    leaves = leaves_of(size, salt)
    theirs = InmemoryTree(algorithm="sha256")
    for leaf in leaves:
        theirs.append_entry(leaf)
    ours = tree_of(leaves, ProvingTree(index))
    assert theirs.get_root() == ours.root
    proof = theirs.prove_inclusion(index + 1, size)
    verify_inclusion(theirs.get_leaf(index + 1), ours.root, proof)
    own, *beside = proof.path
    assert (own, tuple(beside)) == (leaf_hash(leaves[index]), ours.proof)
