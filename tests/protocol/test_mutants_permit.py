"""What the mutants of the permit's module showed to be missing: the derived key itself."""

import hashlib
import hmac

from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC

from cutgate.protocol.conversation import Reset
from cutgate.protocol.permit import sign
from cutgate.protocol.states import StopCause

KEY = bytes(range(32))


def test_the_code_is_made_with_the_key_of_this_direction():
    """HKDF of RFC 5869 from HMAC alone: no salt, the direction's name as info, 16 bytes."""
    extracted = hmac.digest(bytes(32), KEY, hashlib.sha256)
    derived = hmac.digest(extracted, b"runtime to controller\x01", hashlib.sha256)[:16]
    record = Reset(nonce=bytes(16), epoch=3, session_digest=bytes(32), cause=StopCause.NONE)
    code = CMAC(AES(derived))
    code.update(record.canonical())
    assert sign(KEY, record).code == code.finalize()
