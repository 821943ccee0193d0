"""Fixtures of the plugin's tests."""

import pytest


@pytest.fixture
def within(pytester):
    """Runs the tests of the pytester's folder with these options.

    In a process of its own: of what tests in this process import, pytester forgets some, and the second copy of an
    enumeration has no member of the first.
    """

    def run(*options):
        return pytester.runpytest_subprocess("-p", "no:cacheprovider", *options)

    return run
