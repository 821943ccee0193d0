"""Each fault of a bus is found alone, with the remedy for that cause; an interface that is not used fails nothing."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.model import BusSettings, Site
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import (
    Backend,
    CanInterface,
    Interfaces,
    LinkDetail,
    LocalBus,
    RawSocket,
    SocketRefusal,
)
from cutgate.runtime.doctor.finding import Condition
from cutgate.runtime.doctor.judges.can_bus import (
    judge_backend,
    judge_interfaces,
    judge_local,
    judge_socket,
)

CAN0 = Examined(Site(), None, "socketcan", "can0")
FD = replace(CAN0, site=Site(bus=BusSettings(fd=True)))
LOCAL = Examined(Site(), None, "cutgate", "bus0")
DETAIL = LinkDetail("ERROR-ACTIVE", 1_000_000, 0, 0, 0, frozenset())
GOOD = CanInterface("can0", virtual=False, up=True, mtu=16, queue_frames=10, detail=DETAIL)
VCAN = CanInterface("vcan0", virtual=True, up=True, mtu=72, queue_frames=1000, detail=None)


def interface(one, examined=CAN0, no_detail=""):
    """What is found of one interface."""
    found = list(judge_interfaces(Interfaces((one,), no_detail), examined))
    return next(line for line in found if line.name == f"CAN interface {one.name}")


def with_detail(**changed):
    return replace(GOOD, detail=replace(DETAIL, **changed))


FAULTS = {
    "down": (
        replace(GOOD, up=False),
        Condition.FAIL,
        "ip link set can0 up txqueuelen 10 type can bitrate 1000000",
    ),
    "down and never set up": (
        replace(GOOD, up=False, detail=replace(DETAIL, state="STOPPED", bitrate_bit_s=None)),
        Condition.FAIL,
        "bitrate RATE (the controller's, bit/s)",
    ),
    "bus-off": (with_detail(state="BUS-OFF"), Condition.FAIL, "ip link set can0 type can restart"),
    "bus-off, restarts": (
        with_detail(state="BUS-OFF", restart_ms=100),
        Condition.FAIL,
        "it restarts by itself after 100 ms",
    ),
    "error-passive": (with_detail(state="ERROR-PASSIVE"), Condition.FAIL, "termination"),
    "error-warning": (with_detail(state="ERROR-WARNING"), Condition.WARNING, "termination"),
    "stopped": (with_detail(state="STOPPED"), Condition.FAIL, "ip link set can0 down && ip link set can0 up"),
    "without a bit rate": (with_detail(bitrate_bit_s=0), Condition.FAIL, "bitrate RATE"),
    "listen-only": (with_detail(modes=frozenset({"LISTEN-ONLY"})), Condition.FAIL, "listen-only off"),
    "loopback": (with_detail(modes=frozenset({"LOOPBACK"})), Condition.FAIL, "loopback off"),
    "one-shot": (with_detail(modes=frozenset({"ONE-SHOT"})), Condition.WARNING, "one-shot off"),
    "long queue": (replace(GOOD, queue_frames=1000), Condition.WARNING, "ip link set can0 txqueuelen 10"),
    "no queue": (replace(GOOD, queue_frames=0), Condition.WARNING, "ip link set can0 txqueuelen 10"),
}


@pytest.mark.parametrize("one", [GOOD, replace(GOOD, queue_frames=1), with_detail(modes=frozenset({"FD"}))])
def test_a_good_interface_is_good(one):
    found = interface(one)
    assert (found.state, found.remedy) == (Condition.OK, "")
    for value in (
        "up",
        "ERROR-ACTIVE",
        "1000000 bit/s",
        "errors tx 0 rx 0",
        "restart-ms 0",
        "txqueuelen",
    ):
        assert value in found.found


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_alone_is_found_with_its_remedy(fault):
    one, state, remedy = FAULTS[fault]
    found = interface(one)
    assert found.state is state
    assert remedy in found.remedy
    assert "; " not in found.bound, "another rule is broken as well"


@pytest.mark.parametrize("fault", FAULTS)
def test_of_an_interface_that_no_session_uses_nothing_is_a_failure(fault):
    one, _, remedy = FAULTS[fault]
    for examined in (LOCAL, replace(CAN0, channel="can1")):
        found = interface(one, examined)
        assert found.state is Condition.WARNING
        assert remedy in found.remedy


def test_an_interface_of_that_name_of_another_backend_is_not_the_one_used():
    assert interface(FAULTS["down"][0], replace(CAN0, interface="slcan")).state is Condition.WARNING


def test_several_faults_are_all_told_and_the_worst_decides():
    found = interface(replace(with_detail(state="BUS-OFF"), queue_frames=1000))
    assert found.state is Condition.FAIL
    assert "not bus-off; txqueuelen" in found.bound
    assert "type can restart; as root: ip link set can0 txqueuelen 10" in found.remedy


def test_fd_needs_an_interface_that_carries_it():
    assert interface(GOOD, FD).state is Condition.FAIL
    assert "dbitrate 5000000 fd on" in interface(GOOD, FD).remedy
    assert interface(replace(GOOD, mtu=72), FD).state is Condition.OK
    vcan = replace(FD, channel="vcan0")
    assert "ip link set vcan0 mtu 72" in interface(replace(VCAN, mtu=16), vcan).remedy
    assert interface(VCAN, vcan).state is Condition.OK


def test_a_virtual_interface_needs_nothing_but_to_be_up():
    vcan = replace(CAN0, channel="vcan0")
    assert (interface(VCAN, vcan).state, interface(VCAN, vcan).bound) == (Condition.OK, "up")
    assert interface(GOOD).bound.startswith("up, error-active")
    found = interface(replace(VCAN, up=False), vcan)
    assert (found.state, found.remedy) == (Condition.FAIL, "as root: ip link set vcan0 up")


@pytest.mark.parametrize("member", ["state", "bitrate_bit_s"])
def test_what_is_not_said_is_unknown_and_never_good(member):
    found = interface(with_detail(**{member: None}))
    assert found.state is Condition.UNKNOWN
    assert "ip -details" in found.found


def test_hardware_of_which_nothing_is_said_is_unknown_with_the_reason():
    found = interface(replace(GOOD, detail=None), no_detail="there is no ip program")
    assert found.state is Condition.UNKNOWN
    assert "there is no ip program" in found.found
    assert "iproute2" in found.remedy


@pytest.mark.parametrize("queue", [10, 1000])
def test_without_a_word_of_ip_an_interface_may_be_virtual_and_its_queue_right(queue):
    one = replace(GOOD, detail=None, queue_frames=queue)
    assert interface(one, no_detail="there is no ip program").state is Condition.UNKNOWN
    down = interface(replace(one, up=False), no_detail="there is no ip program")
    assert down.state is Condition.FAIL
    assert down.remedy.startswith("see why ip says nothing (package iproute2); as root: ip link set can0 up")


@given(
    st.builds(
        LinkDetail,
        state=st.none()
        | st.sampled_from(["ERROR-ACTIVE", "ERROR-WARNING", "ERROR-PASSIVE", "BUS-OFF", "STOPPED"]),
        bitrate_bit_s=st.none() | st.integers(0, 10**6),
        tx_errors=st.none() | st.integers(0, 255),
        rx_errors=st.none() | st.integers(0, 255),
        restart_ms=st.none() | st.integers(0, 1000),
        modes=st.frozensets(st.sampled_from(["LISTEN-ONLY", "LOOPBACK", "ONE-SHOT", "FD"])),
    )
    | st.none(),
    st.booleans(),
    st.booleans(),
    st.sampled_from([16, 72]),
    st.integers(0, 2000),
)
def test_good_is_only_what_keeps_every_rule(detail, virtual, up, mtu, queue):
    """An independent statement of what a session needs of its interface."""
    one = CanInterface("can0", virtual, up, mtu, queue, detail)
    found = interface(one, FD)
    hardware = (
        detail is not None
        and detail.state == "ERROR-ACTIVE"
        and detail.bitrate_bit_s is not None
        and detail.bitrate_bit_s > 0
        and not detail.modes - {"FD"}
        and 0 < queue <= 10
    )
    assert (found.state is Condition.OK) is (up and mtu == 72 and (virtual or hardware))
    assert bool(found.remedy) is (found.state is not Condition.OK)


# ---------------------------------------------------------------- the bus itself


def bus(facts, examined):
    return next((one for one in judge_interfaces(facts, examined) if one.name == "bus"), None)


def test_the_interface_that_is_used_must_be_there():
    assert bus(Interfaces((GOOD,)), CAN0).state is Condition.OK
    missing = bus(Interfaces((VCAN,)), CAN0)
    assert missing.state is Condition.FAIL
    assert "socketcan/can0: no such CAN interface, there is vcan0" in missing.found
    assert "attach the adapter" in missing.remedy
    vcan = bus(Interfaces(()), replace(CAN0, channel="vcan0"))
    assert vcan.remedy.endswith("ip link add dev vcan0 type vcan && ip link set vcan0 up")
    assert "there is none" in vcan.found
    assert bus(Interfaces(()), LOCAL) is None


def test_virtual_can_is_told_and_not_needed():
    for found, told in (((VCAN, GOOD), "vcan0"), ((), "none")):
        line = list(judge_interfaces(Interfaces(found), LOCAL))[-1]
        assert (line.name, line.state, line.found) == ("virtual CAN (vcan)", Condition.OK, told)


@pytest.mark.parametrize(
    ("interface_name", "known", "state", "told"),
    [
        ("udp_multicast", True, Condition.FAIL, "leaves this machine"),
        ("socketcand", True, Condition.FAIL, "leaves this machine"),
        ("pcna", False, Condition.FAIL, "not known"),
        ("pcan", True, Condition.UNKNOWN, "opening it would set the hardware up"),
    ],
)
def test_another_backend_is_never_good_unseen(interface_name, known, state, told):
    (found,) = judge_backend(Backend(known), Examined(Site(), None, interface_name, "PCAN_USBBUS1"))
    assert found.state is state
    assert told in found.found
    assert found.remedy


def test_our_own_backends_have_lines_of_their_own():
    for examined in (CAN0, LOCAL):
        assert list(judge_backend(Backend(known=False), examined)) == []


@pytest.mark.parametrize("refused", SocketRefusal)
def test_a_raw_socket_that_is_refused(refused):
    (needed,), (not_needed,) = (judge_socket(RawSocket(refused), one) for one in (CAN0, LOCAL))
    assert (needed.state, not_needed.state) == (Condition.FAIL, Condition.WARNING)
    assert needed.found == not_needed.found == refused.value
    assert "for a controller" in not_needed.bound
    assert "for a controller" not in needed.bound
    assert needed.remedy
    assert (needed.remedy.count("modprobe") > 0) is (refused is not SocketRefusal.FORBIDDEN)


def test_a_raw_socket_that_is_had():
    for examined in (CAN0, LOCAL):
        (found,) = judge_socket(RawSocket(None), examined)
        assert (found.state, found.remedy) == (Condition.OK, "")


@pytest.mark.parametrize(
    ("facts", "state", "remedy"),
    [
        (LocalBus("/run/bus0.sock", there=True, refused=None), Condition.OK, ""),
        (
            LocalBus("/run/bus0.sock", there=False, refused=None),
            Condition.FAIL,
            "start it: cutgate bus serve",
        ),
        (
            LocalBus("/run/bus0.sock", there=True, refused="the hub is not ours"),
            Condition.FAIL,
            "end who serves there",
        ),
    ],
)
def test_the_local_bus_must_serve_where_it_is_used(facts, state, remedy):
    (used,), (unused,) = (judge_local(facts, one) for one in (LOCAL, CAN0))
    assert used.state is state
    assert used.remedy.startswith(remedy)
    assert bool(used.remedy) is bool(remedy)
    assert (unused.state, unused.remedy, unused.bound) == (Condition.OK, "", "not needed")
    serving = state is Condition.OK
    assert used.found == (facts.refused or f"{'serving' if serving else 'nobody serves'} at /run/bus0.sock")


def test_a_hub_of_another_socket_is_started_there():
    (found,) = judge_local(
        LocalBus("/run/a b/bus.sock", there=False, refused=None), replace(LOCAL, channel="/run/a b/bus.sock")
    )
    assert found.remedy.startswith("start it: cutgate bus serve --socket '/run/a b/bus.sock';")
