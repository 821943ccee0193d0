"""What was signed of a permit or start, read from its record in the log."""

import pytest

from cutgate.protocol import records as wire
from cutgate.runtime.audit.records import AuditPermit
from cutgate.runtime.audit.signed import canonical, signed
from tests.runtime.audit.build import wire_permit, wire_start

LOG = wire.TreeHead(bytes(range(16)), 7, bytes(range(32)))
PERMIT = wire_permit(log=LOG)
START = wire_start(PERMIT, LOG)


def record(data, size=7):
    return AuditPermit(kind="permit", stage="sent", token=1, record=data, log_size=size)


@pytest.mark.parametrize("kept", [PERMIT, START], ids=["permit", "start"])
def test_it_is_what_was_signed(kept):
    told = record(kept.canonical().hex())
    assert signed(type(kept), told) == kept
    assert canonical(told) == kept.canonical()


@pytest.mark.parametrize("kept", [PERMIT, START], ids=["permit", "start"])
def test_before_version_4_it_names_no_tree(kept):
    older = kept.canonical()[: -len(LOG.body())].hex()
    assert signed(type(kept), record(older, size=None)).log == wire.NO_TREE_HEAD
    with pytest.raises(ValueError):
        signed(type(kept), record(older))


@pytest.mark.parametrize(
    "data", [None, "", "00", "xyz", PERMIT.canonical().hex() + "00", PERMIT.canonical()[1:].hex()]
)
def test_what_cannot_be_read_is_refused(data):
    with pytest.raises(ValueError):
        signed(wire.Permit, record(data))


def test_what_is_no_hexadecimal_has_no_bytes():
    assert canonical(record(None)) == b""
    with pytest.raises(ValueError):
        canonical(record("xyz"))
