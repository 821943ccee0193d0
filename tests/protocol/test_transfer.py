"""Records over ISO-TP: whole or not at all, never blocking, never silent."""

import logging
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.protocol.transfer import BLOCK_FRAMES, FD_LENGTHS, PAYLOAD_BYTES_MAX, Transfer, TransferError

SOCKET_BUFFER_FRAMES = 278


both_kinds = pytest.mark.parametrize("fd", [False, True], ids=["classic", "FD"])


def pair(*, fd: bool = False) -> tuple[Transfer, Transfer]:
    return Transfer(0x600, 0x601, fd=fd), Transfer(0x601, 0x600, fd=fd)


def step(sender: Transfer, receiver: Transfer) -> int:
    """Carry what waits, both ways; how many frames."""
    frames = sender.outgoing()
    for _, data in frames:
        receiver.feed(data)
    back = receiver.outgoing()
    for _, data in back:
        sender.feed(data)
    return len(frames) + len(back)


def carry(sender: Transfer, receiver: Transfer) -> None:
    while step(sender, receiver):
        pass


def patterned(length: int, seed: int = 0) -> bytes:
    return bytes((seed + 7 * at + at // 251) % 256 for at in range(length))


def quiet(*transfers: Transfer) -> bool:
    return not any(transfer.errors() for transfer in transfers)


@both_kinds
@pytest.mark.parametrize("length", [1, 6, 7, 8, 13, 14, 61, 62, 63, 64, 125, 126, 223, 230, 231, 4000, 4095])
def test_record_arrives_whole(length: int, fd: bool):
    one, other = pair(fd=fd)
    one.send(patterned(length), 0.0)
    carry(one, other)
    assert other.received() == [patterned(length)]
    assert other.received() == []
    assert not one.busy
    assert not other.busy
    assert quiet(one, other)


@given(
    st.lists(st.binary(min_size=1, max_size=300), max_size=6),
    st.lists(st.binary(min_size=1, max_size=300), max_size=6),
)
@settings(max_examples=50)
def test_queued_records_arrive_in_order_both_ways(there: list[bytes], back: list[bytes]):
    one, other = pair()
    for payload in there:
        one.send(payload, 0.0)
    for payload in back:
        other.send(payload, 0.0)
    carry(one, other)
    assert other.received() == there
    assert one.received() == back
    assert quiet(one, other)


@pytest.mark.parametrize("length", [0, 4096])
def test_record_of_another_length_is_refused(length: int):
    with pytest.raises(ValueError, match=r"must be 1\.\.4095"):
        pair()[0].send(bytes(length), 0.0)


def test_frames_are_classic_padded_and_on_the_own_identifier():
    one, other = pair()
    one.send(patterned(4095), 0.0)
    while True:
        sent = one.outgoing()
        for can_id, data in sent:
            assert (can_id, len(data)) == (0x600, 8)
            other.feed(data)
        answered = other.outgoing()
        for can_id, data in answered:
            assert (can_id, len(data)) == (0x601, 8)
            one.feed(data)
        if not sent and not answered:
            return


def test_fd_frames_are_full_but_the_last_which_is_the_shortest_that_holds_the_rest():
    for length in range(1, 300):
        one, other = pair(fd=True)
        one.send(patterned(length), 0.0)
        sent: list[bytes] = []
        while frames := one.outgoing():
            sent += [data for _, data in frames]
            for _, data in frames:
                other.feed(data)
            for _, data in other.outgoing():
                assert len(data) == 8
                one.feed(data)
        head = (1 if length <= 7 else 2) if length <= 62 else 1
        rest = length if length <= 62 else (length - 62 - 1) % 63 + 1
        assert [len(data) for data in sent[:-1]] == [64] * (len(sent) - 1)
        assert len(sent[-1]) == min(size for size in FD_LENGTHS if size >= rest + head)
        assert sent[-1][rest + head :] == b"\xcc" * (len(sent[-1]) - rest - head)


@both_kinds
@given(
    lengths=st.lists(st.integers(1, 4095), min_size=1, max_size=4),
    disturbed=st.lists(
        st.tuples(st.integers(0, 300), st.sampled_from(["lost", "doubled", "late"]), st.booleans()),
        max_size=4,
    ),
)
@settings(max_examples=60, deadline=None)
def test_whatever_is_lost_doubled_or_late_a_record_arrives_whole_or_not_at_all(
    lengths: list[int], disturbed: list[tuple[int, str, bool]], fd: bool
):
    """Frames of both directions are counted; what is late comes behind the next frame of its direction."""
    one, other = pair(fd=fd)
    sent = [patterned(length, seed) for seed, length in enumerate(lengths)]
    for payload in sent:
        one.send(payload, 0.0)
    what = {(back, at): change for at, change, back in disturbed}
    count, held = {False: 0, True: 0}, {False: [], True: []}

    def carried(frames: list[tuple[int, bytes]], back: bool) -> list[bytes]:
        out: list[bytes] = []
        for _, data in frames:
            change = what.get((back, count[back]))
            count[back] += 1
            waiting, held[back] = held[back], [data] if change == "late" else []
            out += [data] * {None: 1, "lost": 0, "doubled": 2, "late": 0}[change] + waiting
        return out

    received: list[bytes] = []
    while frames := one.outgoing():
        for data in carried(frames, False):
            other.feed(data)
        received += other.received()
        for data in carried(other.outgoing(), True):
            one.feed(data)
    assert all(payload in sent for payload in received)
    if not disturbed:
        assert received == sent
        assert not one.busy
    for transfer in (one, other):  # what does not go on is given up in words
        stood = transfer.busy
        expired = transfer.expire(0.0) or transfer.expire(2.0)
        assert (expired is not None) is stood
        assert not transfer.busy


def test_fd_side_that_is_given_up_asks_for_the_other_side():
    one, _ = pair(fd=True)
    one.send(patterned(100), 0.0)
    one.expire(0.0)
    expired = one.expire(2.0)
    assert expired is not None
    assert expired.reason.endswith("; do both sides use CAN FD?")


@pytest.mark.parametrize("length", [7, 9, 10, 63])
def test_frame_that_no_fd_transfer_has_is_reported(length: int):
    one, _ = pair(fd=True)
    one.feed(bytes(length))
    (error,) = one.errors()
    assert (error.lost, error.reason) == (
        False,
        f"frame is {length} bytes, must be 8, 12, 16, 20, 24, 32, 48, 64",
    )


@pytest.mark.parametrize(
    ("length", "announced", "begins"),
    [(64, 63, True), (64, 62, False), (64, 4095, True), (48, 4095, False), (8, 100, False)],
)
def test_fd_first_frame_is_full_and_announces_what_needs_another(length: int, announced: int, begins: bool):
    _, other = pair(fd=True)
    other.feed(bytes([0x10 | announced >> 8, announced & 0xFF]).ljust(length, b"a"))
    assert other.receiving is begins
    assert bool(other.errors()) is not begins
    assert bool(other.outgoing()) is begins


def test_short_frame_amid_an_fd_record_never_completes_it():
    _, other = pair(fd=True)
    other.feed(bytes([0x10, 200]).ljust(64, b"a"))
    other.feed(b"\x21".ljust(32, b"a"))
    assert [error.lost for error in other.errors()] == [False]
    other.feed(b"\x22".ljust(64, b"a"))
    assert [error.lost for error in other.errors()] == [True]
    assert other.received() == []


def test_never_more_frames_at_once_than_a_socket_buffer_holds():
    one, other = pair()
    for _ in range(3):
        one.send(patterned(4095), 0.0)
    most = 0
    while one.busy or other.busy:
        frames = one.outgoing()
        most = max(most, len(frames))
        for _, data in frames:
            other.feed(data)
        for _, data in other.outgoing():
            one.feed(data)
    assert most <= BLOCK_FRAMES + 2 < SOCKET_BUFFER_FRAMES
    assert len(other.received()) == 3


@pytest.mark.parametrize("blocks", [0, BLOCK_FRAMES + 1, 255])
def test_peer_that_asks_for_long_blocks_is_refused(blocks: int):
    one, _ = pair()
    one.send(patterned(100), 0.0)
    one.send(b"next", 0.0)
    one.outgoing()
    one.feed(bytes([0x30, blocks, 0]).ljust(8, b"\xcc"))
    (error,) = one.errors()
    assert error.lost
    assert "must be 1..32" in error.reason
    assert not one.sending
    assert one.outgoing() == []


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("pause", [0x01, 0x7F, 0x80, 0xF1, 0xFF])
def test_peer_that_asks_for_a_separation_time_is_refused(pause: int, fd: bool):
    """Passed over, it would drown a receiver that is slower than the bus: its record would be lost without a reason."""
    one, _ = pair(fd=fd)
    one.send(patterned(100), 0.0)
    one.send(b"next", 0.0)
    one.outgoing()
    one.feed(bytes([0x30, BLOCK_FRAMES, pause]).ljust(8, b"\xcc"))
    (error,) = one.errors()
    assert error == TransferError(
        f"flow control asks for a separation time (STmin) of {pause:#04x}, must be 0", lost=True, refused=True
    )
    assert not one.sending
    assert one.outgoing() == []


def test_flow_control_for_nothing_loses_nothing_whatever_it_asks_for():
    one, other = pair()
    one.feed(bytes([0x30, BLOCK_FRAMES, 10]).ljust(8, b"\xcc"))
    assert [error.lost for error in one.errors()] == [False]
    one.send(patterned(100), 0.0)
    carry(one, other)
    assert other.received() == [patterned(100)]


@pytest.mark.parametrize("at", range(6))
@pytest.mark.parametrize("what", ["lost", "doubled", "swapped", "forged"])
def test_disturbed_transfer_never_yields_a_wrong_record(at: int, what: str):
    """ISO-TP carries no CRC: a forged frame may pass here, and is caught by the envelope's."""
    one, other = pair()
    one.send(patterned(40), 0.0)
    frames = [data for _, data in one.outgoing()]
    other.feed(frames[0])
    for _, data in other.outgoing():
        one.feed(data)
    frames += [data for _, data in one.outgoing()]
    assert len(frames) == 6
    feed = list(frames)
    if what == "lost":
        del feed[at]
    elif what == "doubled":
        feed.insert(at, feed[at])
    elif what == "swapped":
        feed[at - 1], feed[at] = feed[at], feed[at - 1]
    else:
        feed[at] = bytes([feed[at][0]]) + b"\0" * 7
    fresh = Transfer(0x601, 0x600)
    for data in feed:
        fresh.feed(data)
        fresh.outgoing()
    received = fresh.received()
    if what == "forged" and at > 0:
        assert received != [patterned(40)]
    elif what == "doubled" and at in (0, 5):
        assert received == [patterned(40)]
        assert fresh.errors()
    else:
        assert received == []
        assert fresh.errors() or fresh.receiving


def test_wrong_sequence_is_a_lost_record():
    _, other = pair()
    other.feed(b"\x10\x28abcdef")
    other.feed(b"\x23abcdefg")
    (error,) = other.errors()
    assert error.lost
    assert "SequenceNumber" in error.reason
    assert not other.receiving


@pytest.mark.parametrize(
    "data",
    [
        b"\x21abcdefg",
        b"\x30\x20\x00\xcc\xcc\xcc\xcc\xcc",
        b"\x00\xcc\xcc\xcc\xcc\xcc\xcc\xcc",
        b"\x40" + bytes(7),
    ],
)
def test_stray_frame_loses_nothing_and_is_reported(data: bytes):
    one, _ = pair()
    one.feed(data)
    (error,) = one.errors()
    assert not error.lost
    assert one.errors() == []


@pytest.mark.parametrize(("length", "escape"), [(1, False), (7, False), (0, True), (1, True), (7, True)])
def test_first_frame_of_a_record_that_needs_none_is_ignored(length: int, escape: bool):
    _, other = pair()
    long = (b"\x10\x00" + length.to_bytes(4, "big")) if escape else bytes([0x10, length])
    other.feed(long.ljust(8, b"a"))
    assert [error.lost for error in other.errors()] == [False]
    assert not other.receiving
    assert other.outgoing() == []


def test_long_form_of_a_short_length_is_ignored():
    _, other = pair()
    other.feed(b"\x10\x00" + PAYLOAD_BYTES_MAX.to_bytes(4, "big") + b"ab")
    assert not other.receiving


def test_invalid_frame_amid_a_reception_loses_it():
    _, other = pair()
    other.feed(b"\x10\x28abcdef")
    other.feed(b"\x40" + bytes(7))
    (error,) = other.errors()
    assert error.lost
    assert not other.receiving


@pytest.mark.parametrize("length", [0, 3, 7, 12])
def test_frame_of_another_length_is_reported(length: int):
    one, _ = pair()
    one.feed(bytes(length))
    assert one.errors() == [TransferError(f"frame is {length} bytes, must be 8", lost=False)]


@pytest.mark.parametrize("status", [0x31, 0x32])
def test_peer_that_waits_or_overflows_ends_the_sending_and_what_follows(status: int):
    one, _ = pair()
    one.send(patterned(100), 0.0)
    one.send(b"next", 0.0)
    one.outgoing()
    one.feed(bytes([status, 8, 0]).ljust(8, b"\xcc"))
    assert [error.lost for error in one.errors()] == [True]
    assert not one.sending
    assert one.outgoing() == []


def test_record_too_long_for_the_channel_is_refused_by_the_receiver():
    one, other = pair()
    other.feed(b"\x10\x00" + (PAYLOAD_BYTES_MAX + 1).to_bytes(4, "big") + b"ab")
    assert [error.lost for error in other.errors()] == [True]
    ((can_id, data),) = other.outgoing()
    assert (can_id, data[0]) == (0x601, 0x32)
    assert not one.busy


def test_sender_without_an_answer_expires_by_the_given_clock_alone():
    one, _ = pair()
    assert one.expire(0.0) is None
    one.send(patterned(100), 10.0)
    one.send(b"next", 10.0)
    one.outgoing()
    assert one.expire(10.5) is None
    assert one.expire(11.5) is None
    expired = one.expire(11.500001)
    assert expired is not None
    assert expired.lost
    assert not one.busy
    assert one.outgoing() == []
    assert one.expire(1e9) is None


def test_receiver_without_the_next_frame_expires():
    _, other = pair()
    other.feed(b"\x10\x28abcdef")
    assert other.expire(1.0) is None
    other.feed(b"\x21abcdefg")
    assert other.expire(1.9) is None
    assert other.expire(2.9) is None
    assert other.expire(2.900001) is not None
    assert not other.receiving
    other.feed(b"\x22abcdefg")
    assert other.received() == []


def test_stray_frames_do_not_keep_a_dead_transfer_alive():
    _, other = pair()
    other.feed(b"\x10\x28abcdef")
    now_s = 0.0
    while other.expire(now_s) is None:
        other.feed(b"\x30\x08\x00\xcc\xcc\xcc\xcc\xcc")
        now_s += 0.1
        assert now_s < 2.0
    assert now_s == pytest.approx(1.1)


@pytest.mark.parametrize("now_s", [float("nan"), -5.0])
def test_clock_that_makes_no_sense_expires(now_s: float):
    one, _ = pair()
    one.send(patterned(100), 0.0)
    one.outgoing()
    assert one.expire(0.0) is None
    assert one.expire(now_s) is not None


def test_progress_of_one_direction_does_not_hide_the_other():
    """A record comes in at a block a tenth of a second, each answered; our own gets no answer at all."""
    one, _ = pair()
    one.send(patterned(100), 0.0)
    one.outgoing()
    now_s = 0.0
    one.feed(b"\x1f\xffabcdef")
    frames = 0
    while one.expire(now_s) is None:
        for _ in range(BLOCK_FRAMES):
            frames += 1
            one.feed(bytes([0x20 | frames % 16]) + b"abcdefg")
        assert one.receiving
        assert [data[0] for _, data in one.outgoing()][-1] == 0x30
        now_s += 0.1
    assert now_s == pytest.approx(1.1)


def test_abort_voids_both_directions_and_what_was_received():
    one, other = pair()
    one.send(b"whole", 0.0)
    carry(one, other)
    other.send(patterned(100), 0.0)
    other.feed(b"\x10\x28abcdef")
    other.abort()
    assert other.received() == []
    assert other.outgoing() == []
    assert not other.busy
    other.feed(b"\x21abcdefg")
    assert [error.lost for error in other.errors()] == [False]
    assert other.received() == []


def test_channel_works_again_after_an_abort():
    one, other = pair()
    one.send(patterned(500), 0.0)
    step(one, other)
    for side in (one, other):
        side.abort()
    one.send(patterned(600), 1.0)
    carry(one, other)
    assert other.received() == [patterned(600)]
    assert quiet(one, other)


def test_peer_that_begins_anew_is_understood_and_the_interruption_reported():
    one, other = pair()
    one.send(patterned(100), 0.0)
    for _, data in one.outgoing():
        other.feed(data)
    other.outgoing()
    one.abort()
    one.send(patterned(200), 0.0)
    carry(one, other)
    assert other.received() == [patterned(200)]
    assert [error.lost for error in other.errors()] == [True]
    other.feed(b"\x10\x28abcdef")
    other.feed(b"\x02ab\xcc\xcc\xcc\xcc\xcc")
    assert other.received() == [b"ab"]
    assert [error.lost for error in other.errors()] == [True]


def test_errors_are_values_and_never_log_lines(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
):
    one, _ = pair()
    with caplog.at_level(logging.DEBUG):
        one.feed(b"\x21abcdefg")
    assert one.errors()
    assert not caplog.records
    assert capsys.readouterr().err == ""


def test_no_clock_and_no_sleep_is_used(monkeypatch: pytest.MonkeyPatch):
    """The wall clock stands a year ahead after the first frame; the transfer does not notice."""

    def no_sleep(_seconds: float) -> None:
        raise AssertionError("slept")

    monkeypatch.setattr(time, "sleep", no_sleep)
    clock = [0]
    monkeypatch.setattr(time, "perf_counter_ns", lambda: clock[0])
    one, other = pair()
    one.send(patterned(1000), 0.0)
    while step(one, other):
        clock[0] += 86_400 * 10**9
    assert other.received() == [patterned(1000)]
    assert quiet(one, other)


@both_kinds
@given(frames=st.lists(st.binary(min_size=8, max_size=8) | st.binary(min_size=64, max_size=64), max_size=40))
def test_any_frames_raise_nothing(frames: list[bytes], fd: bool):
    one, _ = pair(fd=fd)
    one.send(patterned(50), 0.0)
    for data in frames:
        one.feed(data)
        one.expire(0.0)
    one.received()
    one.outgoing()
    one.errors()


def test_what_goes_out_is_voided_frames_and_queue_and_what_comes_in_is_received():
    one, other = pair()
    one.send(patterned(100), 0.0)
    one.send(patterned(50), 0.0)
    other.send(patterned(200, 3), 0.0)
    for _, data in other.outgoing():
        one.feed(data)
    one.stop_sending()
    assert not one.sending
    assert [data[0] for _, data in one._outbox] == [0x30], "only the flow control for what comes in"
    carry(one, other)
    assert one.received() == [patterned(200, 3)]
    assert other.received() == []
    one.send(patterned(30), 0.0)
    carry(one, other)
    assert other.received() == [patterned(30)]
