"""A session for tests: its codes, and frames made by hand that a holder of the key could have made."""

from dataclasses import replace

from cutgate.protocol import records
from cutgate.protocol.codes import NO_ECHO, PresharedKey, SessionCodes
from cutgate.protocol.frames import ControllerHeartbeat, RuntimeHeartbeat, encode_frame, payload_of

KEY = bytes(range(32))
DIGEST = bytes(range(100, 132))
OTHER_DIGEST = bytes(range(101, 133))
CODES = PresharedKey(KEY).session(DIGEST)
TAG = CODES.tag
OPEN = records.Open(
    protocol_version=records.PROTOCOL_VERSION,
    announce_nonce=bytes(16),
    runtime_nonce=b"nonce".ljust(16),
    identity_digest=bytes(32),
    registration_digest=bytes(32),
    place_digest=bytes(32),
    registration_time_us=1,
    configuration_digest=bytes(32),
    verifier_version="test",
    timing=records.Timing(20, 100, 120, 2000, 500, 200, 10_000, 25),
)


def tagged(
    frame: RuntimeHeartbeat | ControllerHeartbeat,
    counter: int,
    echo: int = NO_ECHO,
    codes: SessionCodes = CODES,
) -> tuple[int, bytes]:
    """Identifier and bytes of a heartbeat with this counter and echo, both of 32 bits."""
    covered = payload_of(frame)[-2:]
    sealed = replace(
        frame, echo=echo % 256, tag=codes.heartbeat_tag(type(frame).SENDER, counter, echo, covered)
    )
    return encode_frame(sealed, counter % 256, codes.tag)
