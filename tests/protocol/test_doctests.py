"""The examples in the docstrings of the protocol do what they say."""

import doctest
import pkgutil
from importlib import import_module

import pytest

from cutgate import protocol

MODULES = [
    import_module(f"cutgate.protocol.{found.name}") for found in pkgutil.iter_modules(protocol.__path__)
]
SHOWN = {"codes", "conversation", "cycle", "differences", "endpoint", "link", "port", "records", "transfer"}
"""Those that have some."""


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_the_examples_do_what_they_say(module):
    result = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert result.failed == 0
    assert (result.attempted > 0) is (module.__name__.rpartition(".")[2] in SHOWN)
