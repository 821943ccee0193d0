"""CAN as made-up folders and answers of ``ip`` tell it; a real hub, and real refusals."""

import errno
import json
import os
import socket
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config import bus as config_bus
from cutgate.config.model import Site
from cutgate.firmware_sim.hil.hub import hub_process
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import LinkDetail, RawSocket, SocketRefusal, Unknown
from cutgate.runtime.doctor.probes import can_bus
from cutgate.runtime.doctor.probes.can_bus import (
    NoDetailError,
    backend,
    interfaces,
    kinds_of,
    local_bus,
    raw_socket,
)

HERE = Examined(Site(), None)
LOCAL = Examined(Site(), None, "cutgate", "bus0")
CAN0 = {
    "ifname": "can0",
    "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"],
    "mtu": 16,
    "txqlen": 10,
    "link_type": "can",
    "linkinfo": {
        "info_kind": "can",
        "info_data": {
            "ctrlmode": ["LOOPBACK", "BERR-REPORTING"],
            "state": "ERROR-ACTIVE",
            "berr_counter": {"tx": 3, "rx": 7},
            "restart_ms": 100,
            "bittiming": {"bitrate": 1000000, "sample_point": "0.750"},
            "clock": 80000000,
        },
    },
}
"""As iproute2 6.1 prints a CAN controller."""

VCAN0 = {"ifname": "vcan0", "txqlen": 1000, "link_type": "can", "linkinfo": {"info_kind": "vcan"}}


def never():
    raise AssertionError("ip must not be asked")


@pytest.fixture
def net(tmp_path):
    """A folder like /sys/class/net with can0, vcan0 and eth0."""
    devices, links = tmp_path / "devices", tmp_path / "net"
    links.mkdir()
    for place, kind, flags, mtu, queue in (
        ("pci/can0", "280", "0x40041", "16", "10"),
        ("virtual/net/vcan0", "280", "0x40", "72", "1000"),
        ("pci/eth0", "1", "0x1003", "1500", "1000"),
    ):
        folder = devices / place
        folder.mkdir(parents=True)
        for name, text in (("type", kind), ("flags", flags), ("mtu", mtu), ("tx_queue_len", queue)):
            (folder / name).write_text(f"{text}\n", encoding="ascii")
        (links / folder.name).symlink_to(folder)
    (links / "bonding_masters").write_text("", encoding="ascii")
    return links


def test_interfaces_are_told_by_sysfs_and_controllers_by_ip(net):
    facts = interfaces(HERE, net, lambda: json.dumps([{"ifname": "eth0"}, CAN0, VCAN0]))
    can0, vcan0 = facts.found
    assert (can0.name, can0.virtual, can0.up, can0.mtu, can0.queue_frames) == ("can0", False, True, 16, 10)
    assert can0.detail == LinkDetail(
        "ERROR-ACTIVE", 1_000_000, 3, 7, 100, frozenset({"LOOPBACK", "BERR-REPORTING"})
    )
    assert (vcan0.name, vcan0.virtual, vcan0.up, vcan0.mtu, vcan0.detail) == ("vcan0", True, False, 72, None)
    assert facts.no_detail == ""


def test_ip_is_not_asked_where_there_is_no_can(net):
    (net / "can0").unlink()
    (net / "vcan0").unlink()
    assert interfaces(HERE, net, never).found == ()


def test_an_interface_is_virtual_only_if_ip_says_so(net):
    """A serial adapter lies among the virtual devices of sysfs too."""
    facts = interfaces(HERE, net, lambda: "[]")
    assert [(one.name, one.virtual, one.detail) for one in facts.found] == [
        ("can0", False, None),
        ("vcan0", False, None),
    ]


def test_without_ip_what_sysfs_says_stays_and_the_reason_is_told(net):
    def absent():
        raise NoDetailError("there is no ip program")

    facts = interfaces(HERE, net, absent)
    assert [one.detail for one in facts.found] == [None, None]
    assert facts.no_detail == "there is no ip program"
    assert interfaces(HERE, net, lambda: "[{").no_detail == "what ip says is no JSON"
    assert interfaces(HERE, net, lambda: "{}").no_detail == "what ip says is no list"


def test_an_interface_that_is_half_gone_is_none(net):
    (net / "can0" / "mtu").unlink()
    assert [one.name for one in interfaces(HERE, net, lambda: "[]").found] == ["vcan0"]


def test_a_kernel_without_sysfs_is_unknown(tmp_path):
    assert isinstance(interfaces(HERE, tmp_path / "none"), Unknown)


def test_what_the_kernel_here_has_is_told():
    assert not isinstance(interfaces(HERE), Unknown)


NAMES = ("state", "bittiming", "bitrate", "ctrlmode", "berr_counter", "tx", "rx", "restart_ms", "info_kind")
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(NAMES), inner, max_size=4),
    max_leaves=12,
)


@given(json_values)
def test_whatever_ip_says_is_a_detail_or_none(info):
    told = kinds_of(
        json.dumps([{"ifname": "can0", "linkinfo": {"info_kind": "can", "info_data": info}}, info])
    )
    detail = told["can0"]
    for value in (detail.bitrate_bit_s, detail.tx_errors, detail.rx_errors, detail.restart_ms):
        assert value is None or type(value) is int
    assert detail.state is None or isinstance(detail.state, str)


def test_nesting_without_end_is_no_answer():
    with pytest.raises(NoDetailError):
        kinds_of("[" * 200_000)


def test_a_fixed_bit_rate_stands_in_another_place():
    data = {"bitrate": 500000, "state": "STOPPED"}
    link = {"ifname": "can1", "linkinfo": {"info_kind": "can", "info_data": data}}
    assert kinds_of(json.dumps([link]))["can1"].bitrate_bit_s == 500000


@pytest.mark.processes
def test_the_ip_of_this_machine_answers_in_a_form_that_is_read():
    try:
        text = can_bus.ip_text()
    except NoDetailError as error:
        pytest.skip(str(error))
    kinds_of(text)
    assert "lo" in [link["ifname"] for link in json.loads(text)]


@pytest.mark.processes
@pytest.mark.parametrize(("script", "told"), [("exit 3", "exit code 3"), ("exec sleep 60", "TimeoutExpired")])
def test_an_ip_that_fails_or_hangs_is_not_waited_for(monkeypatch, tmp_path, script, told):
    (tmp_path / "ip").write_text(f"#!/bin/sh\n{script}\n", encoding="ascii")
    (tmp_path / "ip").chmod(0o755)
    monkeypatch.setattr(can_bus, "IP_FOLDERS", str(tmp_path))
    monkeypatch.setattr(can_bus, "IP_S", 0.2 if "sleep" in script else 20.0)
    with pytest.raises(NoDetailError, match=told):
        can_bus.ip_text()


def test_a_machine_without_ip_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(can_bus, "IP_FOLDERS", str(tmp_path))
    with pytest.raises(NoDetailError, match="there is no ip"):
        can_bus.ip_text()


@pytest.mark.parametrize(
    ("number", "facts"),
    [
        (errno.EAFNOSUPPORT, RawSocket(SocketRefusal.NO_CAN)),
        (errno.EPROTONOSUPPORT, RawSocket(SocketRefusal.NO_RAW)),
        (errno.EPERM, RawSocket(SocketRefusal.FORBIDDEN)),
        (errno.EMFILE, Unknown(f"a raw CAN socket: {os.strerror(errno.EMFILE)}")),
    ],
)
def test_each_refusal_of_a_raw_socket_has_its_cause(number, facts):
    def refused():
        raise OSError(number, os.strerror(number))

    assert raw_socket(HERE, refused) == facts


def test_a_raw_socket_that_opens_is_closed_again():
    opened = socket.socket(socket.AF_UNIX)
    assert raw_socket(HERE, lambda: opened) == RawSocket(None)
    assert opened.fileno() == -1


def test_this_kernel_is_asked_for_a_raw_socket():
    assert (raw_socket(HERE) == RawSocket(None)) is (config_bus.has_socketcan("lo") or _opens())


def _opens():
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def test_python_can_knows_its_interfaces():
    assert backend(replace(HERE, interface="virtual")).known
    assert backend(LOCAL).known
    assert not backend(replace(HERE, interface="virtuel")).known


# ---------------------------------------------------------------- the local bus


def test_looking_for_a_hub_makes_no_directory(monkeypatch, place):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
    facts = local_bus(LOCAL)
    assert (facts.there, facts.refused) == (False, None)
    assert facts.path == str(place / "cutgate" / "bus0.sock")
    assert list(place.iterdir()) == []


def test_a_socket_that_nobody_serves_is_told(place):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as left:
        left.bind(str(place / "bus.sock"))
    facts = local_bus(replace(LOCAL, channel=str(place / "bus.sock")))
    assert facts.there
    assert "no hub is serving there" in facts.refused


def test_what_is_no_socket_is_not_opened(place):
    os.mkfifo(place / "bus.sock")
    assert "is no socket" in local_bus(replace(LOCAL, channel=str(place / "bus.sock"))).refused


def test_a_name_that_is_none_is_told():
    facts = local_bus(replace(LOCAL, channel="a b"))
    assert "'a b'" in facts.refused


def test_a_directory_that_is_open_to_others_is_told(monkeypatch, place):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
    (place / "cutgate").mkdir()
    (place / "cutgate").chmod(0o777)
    assert "mode 0700" in local_bus(LOCAL).refused


def test_of_another_bus_the_usual_hub_is_looked_at(monkeypatch, place):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
    assert local_bus(replace(HERE, channel="can7")).path.endswith("/bus0.sock")


@pytest.mark.processes
def test_a_hub_that_serves_is_joined_and_left(place):
    path = place / "bus.sock"
    with hub_process(path):
        for _ in range(2):
            facts = local_bus(replace(LOCAL, channel=str(path)))
            assert (facts.there, facts.refused) == (True, None)
    assert not local_bus(replace(LOCAL, channel=str(path))).there
