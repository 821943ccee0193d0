"""The examples in the verifiers' docstrings: what they show is what comes."""

import doctest
import importlib

import pytest

from cutgate.runtime.verification import problem

VERIFIERS = (
    "certified",
    "certificate",
    "decide",
    "stocco",
    "plausibility",
    "approach.decision",
    "approach.standing",
    "bounds.chain",
)


def given():
    """The names that the examples of `problem` leave behind, ``stroke`` among them."""
    names = dict(vars(problem))
    (example,) = doctest.DocTestFinder(recurse=False).find(problem, "problem", globs=names)
    assert doctest.DocTestRunner().run(example, clear_globs=False).failed == 0
    return example.globs


@pytest.mark.parametrize("name", VERIFIERS)
def test_the_example_of_a_verifier_is_true(name):
    module = importlib.import_module(f"cutgate.runtime.verification.{name}")
    names = {**given(), **vars(module)}
    (example,) = doctest.DocTestFinder(recurse=False).find(module, name, globs=names)
    assert len(example.examples) >= 2
    said = []
    found = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=said.append)
    assert found.failed == 0, "".join(said)
