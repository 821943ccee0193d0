"""The proof of an admissible verdict: read as written, and judged without an exception whatever it states."""

import struct
from collections.abc import Iterator

from cutgate.runtime.verification.certificate import NAMES, Certificate, CertificateError, certify, recheck
from cutgate.runtime.verification.certified import verify
from cutgate.runtime.verification.recorded import problem_from_records
from tests.runtime.audit.build import inputs, proof_of
from tools.fuzz.harness import Family, attempt, expect


def check(data: bytes) -> None:
    """What parses has one form; what proves says nothing, and what proves nothing says why."""
    certificate = attempt(CertificateError, Certificate.parse, data)
    if certificate is None:
        return
    expect(certificate.body() == data, "a certificate has one form")
    why = recheck(PROBLEM, certificate)
    expect(all(isinstance(reason, str) and reason for reason in why), "each reason is a sentence")
    if not why:
        expect(VERDICT.admissible, "nothing proves an inadmissible path")
        expect((certificate.q0_turns, certificate.roll_turns) == BRANCH, "a proof is for the path's branch")


I = inputs()  # noqa: E741 - as in the log's builders
PROBLEM = problem_from_records(I.path, I.limits, I.calibration, I.tool, I.robot.value)
VERDICT = verify(PROBLEM)
BRANCH = (0, 0)


def _seeds() -> Iterator[bytes]:
    """The proof; with cuts added in and out of order; with lengths that lie; with bounds that are no numbers."""
    body = proof_of()
    if body is None or certify(PROBLEM, VERDICT) is None:
        raise ValueError("the example has no proof")
    yield body
    proof = Certificate.parse(body)
    stated = 32 + 8 * len(proof.bounds)
    for cuts in ([(0, 0.5)], [(0, 0.25), (1, 0.75)], [(3, 0.5), (1, 0.5)], [(9, 0.5)], [(0, float("nan"))]):
        head = body[:24] + struct.pack("<I", len(cuts)) + body[28:stated]
        places = b"".join(struct.pack("<I", segment) for segment, _ in cuts)
        yield head + places + b"".join(struct.pack("<d", fraction) for _, fraction in cuts)
    yield body[:24] + b"\xff\xff\xff\xff" + body[28:]
    yield body[:28] + struct.pack("<I", (1 << len(NAMES)) - 1) + body[32:]
    yield body[:32] + struct.pack("<d", float("inf")) + body[40:]


FAMILY = Family(check, tuple(_seeds()))
