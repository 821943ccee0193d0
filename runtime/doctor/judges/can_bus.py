"""Whether the bus of a session could be opened, and would carry it."""

import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from cutgate.config.bus import LOCAL_CHANNEL, LOCAL_INTERFACE, NOT_PRIVATE
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
from cutgate.runtime.doctor.finding import Condition, Finding, within

QUEUE_MAX: Final = 10
"""Frames of a hardware interface's transmit queue: none of them can be overtaken by a stop (docs/bus.md)."""
MTU_FD: Final = 72
"""Bytes of a CAN FD frame, as the kernel counts them."""
VCAN: Final = "ip link add dev {name} type vcan && ip link set {name} up"
_MODES: Final = "ip link set {name} down && ip link set {name} up type can"
_WIRING: Final = "look at wiring, termination, the bit rate of both sides, and whether the controller is on"

_NO_IP: Final = "see why ip says nothing (package iproute2)"

_SOCKET_REMEDIES: Final = {
    SocketRefusal.NO_CAN: "load it as root, where the kernel has it: modprobe can && modprobe can-raw",
    SocketRefusal.NO_RAW: "load it as root: modprobe can-raw",
    SocketRefusal.FORBIDDEN: "start it outside of what confines it: a container needs the host's network, a unit of "
    "systemd AF_CAN among RestrictAddressFamilies",
}


def judge_socket(facts: RawSocket, examined: Examined) -> Iterable[Finding]:
    """A raw CAN socket may be opened; without a bus of the kernel that is no more than a remark."""
    bound = "may be opened" if examined.in_kernel else "may be opened, for a controller on a CAN interface"
    if facts.refused is None:
        yield Finding("raw CAN socket", Condition.OK, "may be opened", bound)
        return
    state = Condition.FAIL if examined.in_kernel else Condition.WARNING
    yield Finding("raw CAN socket", state, facts.refused.value, bound, _SOCKET_REMEDIES[facts.refused])


def judge_backend(facts: Backend, examined: Examined) -> Iterable[Finding]:
    """Any other interface: python-can knows it, and the bus stays on this machine. Its hardware is not opened."""
    if examined.interface in (LOCAL_INTERFACE, "socketcan"):
        return
    found = f"{examined.interface}/{examined.channel}"
    if examined.interface in NOT_PRIVATE:
        remedy = f"use socketcan or {LOCAL_INTERFACE}"
        yield Finding("bus", Condition.FAIL, f"{found} leaves this machine", "a private bus", remedy)
    elif not facts.known:
        remedy = "correct interface under [bus] of site.toml, or --interface; or install its plugin"
        yield Finding("bus", Condition.FAIL, f"{found}: not known", "an interface of python-can", remedy)
    else:
        remedy = (
            "see with the controller attached: cutgate run, or python-can's own viewer: python -m can.viewer"
        )
        told = f"{found}: opening it would set the hardware up"
        yield Finding("bus", Condition.UNKNOWN, told, "an interface that can be opened", remedy)


def judge_local(facts: LocalBus, examined: Examined) -> Iterable[Finding]:
    """The hub of the local virtual bus is ours and answers, where a session would use it."""
    needed = examined.interface == LOCAL_INTERFACE
    bound = "serving, and ours" if needed else "not needed"
    if facts.there and facts.refused is None:
        yield Finding("local virtual bus", Condition.OK, f"serving at {facts.path}", bound)
        return
    state = Condition.FAIL if needed else Condition.OK
    found = facts.refused or f"nobody serves at {facts.path}"
    named = "" if examined.channel == LOCAL_CHANNEL else f" --socket {shlex.quote(facts.path)}"
    start = f"start it: cutgate bus serve{named}; or name the controller's bus with --interface and --channel"
    if facts.there:
        start = f"end who serves there, if anybody does, and {start}"
    yield Finding("local virtual bus", state, found, bound, start if needed else "")


# ---------------------------------------------------------------- one interface of the kernel


@dataclass(frozen=True, slots=True)
class InterfaceRule:
    """One thing that an interface must be.

    Attributes:
        holds: whether it is; None where nothing says so.
        otherwise: what it is where it does not hold.
        bound: in words.
        remedy: with the interface's name for ``{name}``.
    """

    holds: Callable[[CanInterface, Examined], bool | None]
    otherwise: Condition
    bound: str
    remedy: Callable[[CanInterface], str]


def _in_detail(holds: Callable[[LinkDetail], bool | None]) -> Callable[[CanInterface, Examined], bool | None]:
    """A rule about the controller's details: of what has none it says nothing, a virtual one needs none."""

    def rule(one: CanInterface, _examined: Examined) -> bool | None:
        if one.virtual or not one.up:
            return True
        return None if one.detail is None else holds(one.detail)

    return rule


def _state_is_none_of(*states: str) -> Callable[[CanInterface, Examined], bool | None]:
    return _in_detail(lambda detail: None if detail.state is None else detail.state not in states)


def _without_mode(mode: str) -> Callable[[CanInterface, Examined], bool | None]:
    return _in_detail(lambda detail: mode not in detail.modes)


def _words(text: str) -> Callable[[CanInterface], str]:
    return lambda one: text.format(name=one.name)


def _switched_on(one: CanInterface) -> str:
    if one.detail is None:
        return f"as root: ip link set {one.name} up"
    rate = one.detail.bitrate_bit_s or "RATE (the controller's, bit/s)"
    return f"as root: ip link set {one.name} up txqueuelen {QUEUE_MAX} type can bitrate {rate}"


def _restarted(one: CanInterface) -> str:
    """A controller that restarts by itself cannot be restarted by hand."""
    if one.detail and one.detail.restart_ms:
        return f"{_WIRING}; it restarts by itself after {one.detail.restart_ms} ms"
    return f"{_WIRING}; then as root: ip link set {one.name} type can restart"


def _fd_on(one: CanInterface) -> str:
    if one.virtual:
        return f"as root: ip link set {one.name} mtu {MTU_FD}; or fd = false at both sides"
    told = _MODES.format(name=one.name)
    return f"as root: {told} dbitrate 5000000 fd on; or fd = false at both sides"


RULES: Final = (
    InterfaceRule(lambda one, _: one.up, Condition.FAIL, "up", _switched_on),
    InterfaceRule(_state_is_none_of("BUS-OFF"), Condition.FAIL, "not bus-off", _restarted),
    InterfaceRule(_state_is_none_of("ERROR-PASSIVE"), Condition.FAIL, "not error-passive", _words(_WIRING)),
    InterfaceRule(
        _state_is_none_of("STOPPED", "SLEEPING"),
        Condition.FAIL,
        "not stopped",
        _words("as root: ip link set {name} down && ip link set {name} up"),
    ),
    InterfaceRule(_state_is_none_of("ERROR-WARNING"), Condition.WARNING, "error-active", _words(_WIRING)),
    InterfaceRule(
        _in_detail(lambda detail: None if detail.bitrate_bit_s is None else detail.bitrate_bit_s > 0),
        Condition.FAIL,
        "a bit rate",
        _words(f"as root: {_MODES} bitrate RATE (the controller's, bit/s)"),
    ),
    InterfaceRule(
        _without_mode("LISTEN-ONLY"),
        Condition.FAIL,
        "may send",
        _words(f"as root: {_MODES} listen-only off"),
    ),
    InterfaceRule(
        _without_mode("LOOPBACK"),
        Condition.FAIL,
        "sends to the bus, not to itself",
        _words(f"as root: {_MODES} loopback off"),
    ),
    InterfaceRule(
        _without_mode("ONE-SHOT"),
        Condition.WARNING,
        "repeats what was not acknowledged",
        _words(f"as root: {_MODES} one-shot off"),
    ),
    InterfaceRule(
        lambda one, examined: not examined.site.bus.fd or one.mtu >= MTU_FD,
        Condition.FAIL,
        "carries CAN FD, as fd = true asks",
        _fd_on,
    ),
    InterfaceRule(
        lambda one, _: one.virtual or (None if one.detail is None else 1 <= one.queue_frames <= QUEUE_MAX),
        Condition.WARNING,
        f"txqueuelen 1 to {QUEUE_MAX}: what is queued delays a stop",
        _words(f"as root: ip link set {{name}} txqueuelen {QUEUE_MAX}"),
    ),
)
"""Of those that do not hold the worst decides, and all are told."""


def judge_interfaces(facts: Interfaces, examined: Examined) -> Iterator[Finding]:
    """The interface that a session would use is there and as it must be; of any other nothing is a failure."""
    yield from _bus(facts, examined)
    for one in facts.found:
        used = examined.in_kernel and one.name == examined.channel
        yield _interface(one, examined, used=used, no_detail=facts.no_detail)
    yield _virtual(facts)


def _bus(facts: Interfaces, examined: Examined) -> Iterable[Finding]:
    """The kernel's interface that a session would use is there."""
    if not examined.in_kernel:
        return
    name = examined.channel
    there = any(one.name == name for one in facts.found)
    others = ", ".join(one.name for one in facts.found) or "none"
    if name.startswith("vcan"):
        remedy = f"make it, as root: {VCAN.format(name=name)}"
    else:
        remedy = "attach the adapter and load its driver, or name another with --interface and --channel"
    found = f"{examined.interface}/{name}" + ("" if there else f": no such CAN interface, there is {others}")
    yield Finding(
        "bus", within(there, Condition.FAIL), found, "an interface that is there", "" if there else remedy
    )


def _virtual(facts: Interfaces) -> Finding:
    """Whether the kernel has a virtual CAN interface; nobody needs one."""
    found = ", ".join(one.name for one in facts.found if one.virtual)
    return Finding(
        "virtual CAN (vcan)", Condition.OK, found or "none", "none needed: cutgate bus serve does as well"
    )


def _interface(one: CanInterface, examined: Examined, *, used: bool, no_detail: str) -> Finding:
    told = [(rule, rule.holds(one, examined)) for rule in RULES]
    broken = [rule for rule, holds in told if holds is False]
    unsaid = [rule for rule, holds in told if holds is None]
    name, found = f"CAN interface {one.name}", _shown(one)
    if broken:
        failed = any(rule.otherwise is Condition.FAIL for rule in broken)
        state = Condition.FAIL if failed and used else Condition.WARNING
        bound = "; ".join(rule.bound for rule in broken)
        remedies = [_NO_IP] * bool(no_detail) + [rule.remedy(one) for rule in broken]
        return Finding(name, state, found, bound, "; ".join(remedies))
    if unsaid:
        bound = "; ".join(rule.bound for rule in unsaid)
        why = no_detail or "ip -details does not say all of it"
        remedy = _NO_IP if no_detail else "look at: ip -details -statistics link show"
        return Finding(name, Condition.UNKNOWN, f"{found}; {why}", bound, remedy)
    bound = "up" if one.virtual else "up, error-active, short transmit queue"
    return Finding(name, Condition.OK, found, bound)


def _shown(one: CanInterface) -> str:
    """Everything that is known of it, on one line."""
    parts = ["virtual"] * one.virtual + ["up" if one.up else "down"]
    detail = one.detail
    if detail is not None:
        rate = None if detail.bitrate_bit_s is None else f"{detail.bitrate_bit_s} bit/s"
        errors = None if detail.tx_errors is None else f"errors tx {detail.tx_errors} rx {detail.rx_errors}"
        restart = None if detail.restart_ms is None else f"restart-ms {detail.restart_ms}"
        parts += [part for part in (detail.state, rate, errors, restart, *sorted(detail.modes)) if part]
    return ", ".join([*parts, f"txqueuelen {one.queue_frames}", f"mtu {one.mtu}"])
