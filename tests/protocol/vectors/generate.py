"""Makes the golden vectors from docs/protocol.md alone: it must not import the package that they test.

Plain struct, zlib, hashlib; a bitwise CRC-16; CMAC (RFC 4493) from single AES blocks; HKDF (RFC 5869) from HMAC;
the frames checked once more by autosar-e2e. Run it to write the files beside it.
"""

import hashlib
import hmac
import json
import math
import struct
import zlib
from pathlib import Path

import e2e
from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.ciphers.modes import ECB

HERE = Path(__file__).parent
FORMAT_VERSION = 4
"""Of the vector files: 1 had no versions and no opening.json, 2 none of codes in Open and Opened, and no tags.json; 3 had
blocks of a path as its bytes, and no coding.json."""
PROTOCOL_VERSION = 4
POSES = 250
TAGS = (0x00000001, 0xDEADBEEF, 0xFFFFFFFF)


def patterned(length: int, seed: int) -> bytes:
    """Bytes that differ everywhere, without a random generator."""
    return bytes((seed * 31 + 7 * at + at * at) % 256 for at in range(length))


def crc16(data: bytes) -> int:
    """CRC-16/IBM-3740, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = ((value << 1) ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def aes(key: bytes, block: bytes) -> bytes:
    encryptor = Cipher(AES(key), ECB()).encryptor()
    return encryptor.update(block) + encryptor.finalize()


def cmac(key: bytes, message: bytes) -> bytes:
    """RFC 4493."""

    def doubled(block: bytes) -> bytes:
        value = int.from_bytes(block, "big") << 1
        if value >> 128:
            value = (value & ((1 << 128) - 1)) ^ 0x87
        return value.to_bytes(16, "big")

    first = doubled(aes(key, bytes(16)))
    second = doubled(first)
    blocks = [message[at : at + 16] for at in range(0, len(message), 16)] or [b""]
    last, subkey = blocks[-1], first
    if len(last) < 16:
        last, subkey = (last + b"\x80").ljust(16, b"\0"), second
    state = bytes(16)
    for block in [*blocks[:-1], bytes(a ^ b for a, b in zip(last, subkey, strict=True))]:
        state = aes(key, bytes(a ^ b for a, b in zip(state, block, strict=True)))
    return state


def hkdf16(key: bytes, info: bytes, salt: bytes = bytes(32)) -> bytes:
    """RFC 5869 with SHA-256, 16 bytes; without a salt one of zeros counts."""
    extracted = hmac.new(salt, key, hashlib.sha256).digest()
    return hmac.new(extracted, info + b"\x01", hashlib.sha256).digest()[:16]


def frame(
    can_id: int, name: str, fields: dict[str, int], payload: int, counter: int, tag: int
) -> dict[str, object]:
    """One single frame; payload is the 40-bit little-endian number of bytes 3-7."""
    data_id = 0xC000 + can_id
    covered = bytes([counter]) + (payload & ((1 << 40) - 1)).to_bytes(5, "little")
    crc = crc16(covered + struct.pack("<I", tag) + struct.pack("<H", data_id))
    data = struct.pack("<H", crc) + covered
    assert e2e.p05.e2e_p05_check(data + struct.pack("<I", tag), data_id)
    return {
        "id": can_id,
        "frame": name,
        "fields": fields,
        "counter": counter,
        "tag": tag,
        "data_id": data_id,
        "data": data.hex(),
    }


def frames() -> list[dict[str, object]]:
    """Every single frame, with its fields placed by hand."""
    found = []
    for at, tag in enumerate(TAGS):
        counter = (0, 254, 255)[at]
        echo = (255, 7, 0)[at]
        fault = {"code": 0x6699, "cause": 4, "detail": 0x1234 + at}
        found.append(
            frame(0x010, "ControllerFault", fault, 0x6699 | 4 << 16 | (0x1234 + at) << 24, counter, tag)
        )
        stop = {"code": 0x55AA, "cause": 1, "echo": echo}
        found.append(frame(0x011, "RuntimeStop", stop, 0x55AA | 1 << 16 | echo << 24, counter, tag))
        tagged = 0x1234 + 0x3001 * at
        beat = {"tag": tagged, "echo": echo, "code": 4, "epoch": 29, "cause": 0}
        low = tagged | echo << 16
        found.append(frame(0x080, "RuntimeHeartbeat", beat, low | 4 << 24 | 29 << 27, counter, tag))
        state = {
            "tag": tagged,
            "state": 5,
            "echo": echo,
            "epoch": 9,
            "cause": 26,
            "device_pressed": 1,
            "emergency_stop_ok": at % 2,
            "cutting_mode": 1,
        }
        bits = 26 | 1 << 5 | (at % 2) << 6 | 1 << 7
        found.append(
            frame(0x081, "ControllerHeartbeat", state, low | 5 << 24 | 9 << 27 | bits << 32, counter, tag)
        )
        low = (1 << 20) - 1
        q0, q1, q2, q3, q4 = (-524288, 524287, -1, 12345, -20000)
        found.append(
            frame(0x300, "Joints01", {"q0": q0, "q1": q1}, (q0 & low) | (q1 & low) << 20, counter, tag)
        )
        found.append(
            frame(0x301, "Joints23", {"q2": q2, "q3": q3}, (q2 & low) | (q3 & low) << 20, counter, tag)
        )
        sample = 0xABCDE - at
        found.append(
            frame(0x302, "Joint4", {"q4": q4, "tag": sample}, (q4 & low) | sample << 20, counter, tag)
        )
        progress = {"segment": 1999 + at, "fraction": 65535 - at}
        found.append(frame(0x303, "Progress", progress, (1999 + at) | (65535 - at) << 24, counter, tag))
    return found


def envelope(code: int, session: int, sequence: int, body: bytes) -> str:
    head = struct.pack("<BBHII", code, 0, len(body), session, sequence) + body
    return (head + struct.pack("<I", zlib.crc32(head))).hex()


def named(text: str) -> bytes:
    return text.encode("ascii").ljust(16, b"\0")


KEY, ANNOUNCE_NONCE, RUNTIME_NONCE = patterned(32, 1), patterned(16, 2), patterned(16, 3)
TIMING = {
    "heartbeat_ms": 20,
    "timeout_ms": 100,
    "permit_lifetime_s": 120,
    "start_lifetime_ms": 2000,
    "start_tolerance_um": 500,
    "start_tolerance_mdeg": 200,
    "approach_clearance_um": 70_000,
    "approach_speed_percent": 25,
}
REGISTERED_US = 1_795_000_000_123_456
FAULT, SECOND_NODE = 7, 9


def announce_body(nonce: bytes, state: int, cause: int) -> bytes:
    return (
        struct.pack("<H", PROTOCOL_VERSION) + named("1.2.3") + named("CG-0001") + nonce
        + struct.pack("<IBB", 2500, state, cause)
    )  # fmt: skip


def identity() -> bytes:
    return hashlib.sha256(b"cutgate/identity/1" + announce_body(bytes(16), 1, 0)).digest()


def open_body() -> bytes:
    """Without its code."""
    return (
        struct.pack("<H", PROTOCOL_VERSION) + ANNOUNCE_NONCE + RUNTIME_NONCE + identity()
        + patterned(32, 20) + patterned(32, 22) + struct.pack("<q", REGISTERED_US) + patterned(32, 21)
        + named("certified/1") + struct.pack("<6HIH", *TIMING.values())
    )  # fmt: skip


def session() -> bytes:
    """The digest that names the session."""
    return hashlib.sha256(b"cutgate/session/2" + open_body()).digest()


def session_key(info: bytes) -> bytes:
    return hkdf16(KEY, info, session())


def coded(domain: bytes, sequence: int, body: bytes, direction: bytes = b"runtime to controller") -> bytes:
    """The body with its code, for this session and sequence."""
    covered = domain + b"\0" + session() + struct.pack("<I", sequence) + body
    return body + cmac(session_key(direction + b": record"), covered)


def log(at: int) -> bytes:
    return patterned(16, 30) + struct.pack("<Q", at) + patterned(32, 31 + at % 7)


def signed() -> dict[str, object]:
    """Everything that is signed in a session, with its code; session digest and tag."""
    tag = struct.unpack("<I", session()[:4])[0]
    digests = {
        name: patterned(32, 10 + at) for at, name in enumerate(("limits", "calibration", "tool", "path"))
    }
    digests |= {name: patterned(32, 20 + at) for at, name in enumerate(("registration", "configuration"))}
    joints = (-80_000_000, 45_500_000, 250_000_001, -1, 90_000_000)
    entry, leave = (1, -2, 3, 719_999_999, 5), (-36_000_000_000, 145_000_000, 449_999_999, 7, 8)
    approach = struct.pack("<2I", 92_001, 4_000_000_000) + struct.pack("<10qB", *entry, *leave, 25)
    permit = (
        patterned(16, 4) + ANNOUNCE_NONCE + session() + named("CG-0001")
        + struct.pack("<HB", PROTOCOL_VERSION, 20)
        + b"".join(digests.values()) + named("certified/1") + struct.pack("<5q", *joints)
        + struct.pack("<Bhh", 2, -1, 3) + approach + struct.pack("<H", 120) + log(1000)
    )  # fmt: skip
    digest = hashlib.sha256(b"cutgate/permit/1\0" + permit)
    start = (
        patterned(16, 5) + bytes([20]) + session() + digest.digest() + struct.pack("<5q", *joints) + log(1234)
    )
    reset = patterned(16, 6) + bytes([21]) + session() + bytes([SECOND_NODE])
    opened = bytes([20, 2, 0]) + log(77) + struct.pack("<BIBq", 1, 3600, 45, REGISTERED_US - 1)
    back = coded(b"cutgate/opened/1", 40, opened, b"controller to runtime")
    return {
        "key": KEY.hex(),
        "session_digest": session().hex(),
        "session_tag": tag,
        "serial": "CG-0001",
        "verifier_version": "certified/1",
        "digests": {name: value.hex() for name, value in digests.items()},
        "start_joints_u": list(joints),
        "approach": {
            "entry_um": 92_001,
            "exit_um": 4_000_000_000,
            "entry_joints_u": list(entry),
            "exit_joints_u": list(leave),
            "speed_percent": 25,
        },
        "opened": envelope(0x03, tag, 40, back),
        "permit": envelope(0x07, tag, 41, coded(b"cutgate/permit/1", 41, permit)),
        "permit_digest": digest.hexdigest(),
        "start": envelope(0x08, tag, 42, coded(b"cutgate/start/1", 42, start)),
        "reset": envelope(0x09, tag, 43, coded(b"cutgate/reset/1", 43, reset)),
        "acknowledge": envelope(0x0A, tag, 44, coded(b"cutgate/acknowledge/1", 44, bytes([21, SECOND_NODE]))),
        "withdraw": envelope(
            0x0B,
            tag,
            45,
            coded(
                b"cutgate/withdraw/1", 45, patterned(32, 22) + struct.pack("<q", REGISTERED_US + 60_000_000)
            ),
        ),
    }


def opening() -> dict[str, object]:
    """Announce of a controller that is latched, and Open."""
    body = open_body()
    code = cmac(hkdf16(KEY, b"cutgate/open/1"), b"cutgate/open/1\0" + body)
    return {
        "key": KEY.hex(),
        "announce_nonce": ANNOUNCE_NONCE.hex(),
        "runtime_nonce": RUNTIME_NONCE.hex(),
        "firmware_version": "1.2.3",
        "serial": "CG-0001",
        "plant_speed_permille": 2500,
        "state": FAULT,
        "cause": SECOND_NODE,
        "identity_digest": identity().hex(),
        "registration_digest": patterned(32, 20).hex(),
        "place_digest": patterned(32, 22).hex(),
        "registration_time_us": REGISTERED_US,
        "configuration_digest": patterned(32, 21).hex(),
        "verifier_version": "certified/1",
        "timing": TIMING,
        "announce": envelope(0x01, 0, 1, announce_body(ANNOUNCE_NONCE, FAULT, SECOND_NODE)),
        "open": envelope(0x02, 0, 1, body + code),
    }


COUNTERS = ((0, 0xFFFFFFFF), (255, 254), (256, 255), (70_000, 65_537), (0xFFFFFFFE, 0x01020304))


def tags() -> dict[str, object]:
    """Tags of heartbeats of both directions and of joint samples; counters and echoes of 32 bits."""
    beats = [
        {
            "from": side,
            "counter": counter,
            "echo": echo,
            "last_bytes": covered.hex(),
            "tag": int.from_bytes(
                cmac(session_key(direction + b": heartbeat"), struct.pack("<II", counter, echo) + covered)[
                    :2
                ],
                "little",
            ),
        }
        for side, direction in (
            ("runtime", b"runtime to controller"),
            ("controller", b"controller to runtime"),
        )
        for counter, echo in COUNTERS
        for covered in (bytes([4 | 20 << 3, 0]), bytes([1 | 31 << 3, 14]))
    ]
    joints = (-524288, 524287, -1, 12345, -20000)
    samples = [
        {
            "counter": counter,
            "joints": joints,
            "tag": int.from_bytes(
                cmac(session_key(b"controller to runtime: sample"), struct.pack("<I5i", counter, *joints))[
                    :3
                ],
                "little",
            )
            % (1 << 20),
        }
        for counter, _ in COUNTERS
    ]
    return {"key": KEY.hex(), "session_digest": session().hex(), "heartbeats": beats, "samples": samples}


def parameters() -> dict[str, object]:
    """Limits, calibration and tool of the contract's example, from its decimals."""
    low, high = (
        (-80_000_000, 0, 50_000_000, -170_000_000, 0),
        (80_000_000, 145_000_000, 450_000_000, 170_000_000, 110_000_000),
    )
    # 1 rad/s = 57.29577951... deg/s, rounded down
    speed = (57_295_779, 57_295_779, 200_000_000, 114_591_559, 114_591_559)
    limits = struct.pack("<20q", *low, *high, *speed, *(0,) * 5)
    calibration = struct.pack(
        "<13q",
        450_000_000,
        450_000_000,
        123_457,
        -50_000,
        100_000,
        0,
        -250_000,
        0,
        1,
        1_500_000,
        -2_250_000,
        300_001,
        20_000,
    )
    tool = struct.pack("<q", 160_000_000)
    return {
        name: {"body": body.hex(), "sha256": hashlib.sha256(body).hexdigest(), "envelope": envelope(code, 7, code, body)}
        for name, code, body in (("limits", 0x10, limits), ("calibration", 0x11, calibration), ("tool", 0x12, tool))
    }  # fmt: skip


def octahedral(axis: tuple[float, float, float]) -> tuple[int, int]:
    x, y, z = axis
    size = abs(x) + abs(y) + abs(z)
    u, v = x / size, y / size
    if z < 0:
        u, v = (1 - abs(v)) * (-1 if u < 0 else 1), (1 - abs(u)) * (-1 if v < 0 else 1)
    return round(u * 2**30), round(v * 2**30)


def unfolded(u: int, v: int) -> list[str]:
    """The decoded unit vector, each number as its exact hexadecimal float."""
    z = 2**30 - abs(u) - abs(v)
    x, y = u, v
    if z < 0:
        x = (2**30 - abs(v)) * (-1 if u < 0 else 1)
        y = (2**30 - abs(u)) * (-1 if v < 0 else 1)
    xf, yf, zf = float(x), float(y), float(z)
    length = math.sqrt((xf * xf + yf * yf) + zf * zf)
    return [(part / length + 0.0).hex() for part in (xf, yf, zf)]


def differences(values: list[int], order: int) -> list[int]:
    """Of each value but the first, as numbers of 32 bits: 2 d, or -2 d - 1 where d, signed, is less than 0."""
    numbers = []
    for at in range(1, len(values)):
        most = min(at, order)
        signs = [(-1) ** j * math.comb(most, j) for j in range(most + 1)]
        d = sum(sign * values[at - j] for j, sign in enumerate(signs)) % 2**32
        numbers.append(2 * d if d < 2**31 else 2 * (2**32 - d) - 1)
    return numbers


def numbers_in_bits(numbers: list[int], parameter: int) -> str:
    """As a text of 0 and 1 in the order in which they are sent, each number's least significant bit first."""

    def bits(value: int, width: int) -> str:
        return "".join(str(value >> at & 1) for at in range(width))

    if parameter <= 32:
        return "".join(bits(number, parameter) for number in numbers)
    known = parameter - 33
    zeros = [max(number.bit_length() - known, 0) for number in numbers]
    rest = [
        bits(number, number.bit_length() - 1 if zero else known)
        for number, zero in zip(numbers, zeros, strict=True)
    ]
    return "".join("0" * zero + "1" for zero in zeros) + "".join(rest)


def coded_component(values: list[int], choice: tuple[int, int] | None) -> str:
    """Every order and parameter is tried, unless one is told."""
    found = []
    orders, parameters = ([part] for part in choice) if choice else (range(1, 9), range(64))
    for order in orders:
        numbers = differences(values, order)
        sizes = [number.bit_length() for number in numbers]
        for parameter in parameters:
            if parameter < min(max(sizes, default=0), 33):
                continue  # the longest does not fit
            known = parameter - 33
            cost = sum(
                parameter if parameter <= 32 else known + 1 if b <= known else 2 * b - known for b in sizes
            )
            found.append((cost, order, parameter, numbers))
    _, order, parameter, numbers = min(found)
    head = order - 1 | parameter << 3 | values[0] % 2**32 << 9
    return "".join(str(head >> at & 1) for at in range(41)) + numbers_in_bits(numbers, parameter)


def coded_poses(poses: bytes, choice: dict[int, tuple[int, int]] | None = None, behind: str = "") -> bytes:
    """The poses of a block as they are sent; some components otherwise than with the fewest bits, bits behind them."""
    values = [list(component) for component in zip(*struct.iter_unpack("<5i", poses), strict=True)]
    bits = "".join(coded_component(one, (choice or {}).get(at)) for at, one in enumerate(values)) + behind
    return int(bits[::-1], 2).to_bytes(-(-len(bits) // 8), "little")


def coding() -> dict[str, object]:
    """Blocks of poses and their bytes, and bytes that are refused for so many poses, each for one reason."""

    def packed(*components: list[int]) -> bytes:
        return b"".join(struct.pack("<5i", *pose) for pose in zip(*components, strict=True))

    low, high, steps = -(2**31), 2**31 - 1, range(40)
    still = [[400_000 + at] * 40 for at in range(5)]
    wave = [[round(1e6 * math.comb(7, j % 8) * (-1) ** j) for j in steps] for _ in range(5)]
    pieces = {
        "one pose": packed([1], [-1], [0], [low], [high]),
        "two poses": packed([0, 1], [0, -1], [low, high], [high, low], [7, 7]),
        "nothing moves": packed(*still),
        "each component of another degree": packed(*([at**degree for at in steps] for degree in range(1, 6))),
        "degrees 6 to 8 and more": packed(
            *([(at - 20) ** degree % 2**31 for at in steps] for degree in (6, 7, 8, 9, 12))
        ),
        "from end to end": packed(
            *([low if (at >> shift) % 2 else high for at in steps] for shift in range(5))
        ),
        "a jump in each": packed(
            *([at * 3 + (10**7 if at > 5 * c else 0) for at in steps] for c in range(5))
        ),
        "large waves": packed(*wave),
        "no order in it": patterned(4000, 3)[:4000],
        "200 poses of noise": b"".join(
            hashlib.sha256(struct.pack("<H", at)).digest()[:20] for at in range(200)
        ),
    }
    line = packed(*([1000 * c + (at * at if at % 3 else at) for at in range(9)] for c in range(5)))
    bits = len(coded_poses(line)) * 8
    alone = packed(
        *([7] for _ in range(5))
    )  # of one pose there is nothing behind the fifth component's first value
    refused = {
        "a byte less": (9, coded_poses(line)[:-1]),
        "a byte more": (9, coded_poses(line) + b"\0"),
        "a bit set behind them": (9, coded_poses(line, behind="0" * (bits % 8) + "1")),
        "a pose more than the place has": (8, coded_poses(line)),
        "a pose less than the place has": (10, coded_poses(line)),
        "none": (2, b""),
        "a higher order with as many bits": (40, coded_poses(packed(*still), {4: (2, 0)})),
        "the lowest order where another needs fewer bits": (9, coded_poses(line, {0: (1, 32)})),
        "more bits than the longest number has": (40, coded_poses(packed(*still), {0: (1, 1)})),
        "prefixes where fixed bits need no more": (
            2,
            coded_poses(packed(*([0, 0] for _ in range(5))), {1: (1, 33)}),
        ),
        "a prefix of more zeros than a number has bits": (
            2,
            coded_poses(alone, {4: (1, 33)}, behind="0" * 33 + "1" + "0" * 32),
        ),
        "a prefix without an end": (2, coded_poses(alone, {4: (1, 33)}, behind="0" * 20)),
    }
    return {
        "coded": [
            {"what": what, "poses": poses.hex(), "data": coded_poses(poses).hex()}
            for what, poses in pieces.items()
        ],
        "refused": [
            {"what": what, "poses": count, "data": data.hex()} for what, (count, data) in refused.items()
        ],
    }


def path() -> dict[str, object]:
    """A path whose axis turns from exactly +z to exactly -z through every octant, and its blocks."""
    tips, axes = [], []
    cosine, sine = 1.0, 0.0
    for at in range(POSES):
        # Products and square roots alone: the same bits on every machine. 9/41, 40/41: a turn of 12.7 deg.
        height = 1.0 - 2.0 * at / (POSES - 1)
        radius = math.sqrt(1.0 - height * height)
        axes.append((radius * cosine, radius * sine, height))
        tips.append((400.0 + 0.1237 * at, -20.0 + 0.01 * at, 300.0 - 0.2503 * at))
        cosine, sine = (cosine * 40 - sine * 9) / 41, (sine * 40 + cosine * 9) / 41
    codes = [octahedral(axis) for axis in axes]
    header = b"cutgate.path" + struct.pack(
        "<BBBBhhqqI", 1, 1, 1, 2, -1, 2, 12_345_678, 160_000_000, len(tips)
    )
    body = header + b"".join(
        struct.pack("<5i", *(round(value * 1000) for value in tip), u, v)
        for tip, (u, v) in zip(tips, codes, strict=True)
    )
    blocks = [body[at : at + 4000] for at in range(0, len(body), 4000)]
    return {
        "tips_mm": tips,
        "axes": axes,
        "feed_mm_s": 12.345678,
        "tool_length_mm": 160.0,
        "elbow": "left",
        "q0_turns": -1,
        "roll_turns": 2,
        "decoded_axes": [unfolded(u, v) for u, v in codes],
        "body": body.hex(),
        "sha256": hashlib.sha256(body).hexdigest(),
        "envelopes": [
            envelope(
                0x20,
                7,
                100 + at,
                struct.pack("<HHIII", at, len(blocks), 4000 * at, len(body), zlib.crc32(block))
                + (block[:40] + coded_poses(block[40:]) if at == 0 else coded_poses(block)),
            )
            for at, block in enumerate(blocks)
        ],
    }


def files() -> dict[str, str]:
    """Names and texts of the vector files."""
    versions = {"format_version": FORMAT_VERSION, "protocol_version": PROTOCOL_VERSION}
    made = {
        "frames": {"frames": frames()},
        "opening": opening(),
        "signed": signed(),
        "tags": tags(),
        "parameters": parameters(),
        "coding": coding(),
        "path": path(),
    }
    return {f"{name}.json": json.dumps(versions | value, indent=1) + "\n" for name, value in made.items()}


if __name__ == "__main__":
    for name, text in files().items():
        (HERE / name).write_text(text, encoding="ascii")
