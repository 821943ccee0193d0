"""``cutgate verify --certificate`` and ``cutgate recheck`` as people call them."""

import pytest

from tests.runtime.commands.test_verify import FIRST, MOUNTED, PLAN, SECOND, cutgate

__all__ = ["cutgate"]


@pytest.fixture
def proof(cutgate, tmp_path):
    """The proof of the second registration."""
    file = tmp_path / "proof"
    code, _, err = cutgate("verify", PLAN, *MOUNTED, "--registration", SECOND, "--certificate", file)
    assert code == 0
    assert f"{file}: proof of {file.stat().st_size} bytes" in err
    return file


def test_a_proof_holds_for_what_it_was_made_for(cutgate, proof):
    code, out, err = cutgate("recheck", proof, PLAN, *MOUNTED, "--registration", SECOND)
    assert (code, err) == (0, "")
    assert out.startswith("PROVEN: ")
    assert "each of 1999 intervals" in " ".join(out.split())


def test_it_proves_nothing_about_another_placement(cutgate, proof):
    code, out, _ = cutgate("recheck", proof, PLAN, *MOUNTED, "--registration", FIRST)
    assert code == 1
    assert out.startswith("NOT PROVEN: ")
    assert "outer: " in out


def test_an_inadmissible_path_leaves_no_proof(cutgate, tmp_path):
    file = tmp_path / "proof"
    code, _, err = cutgate("verify", PLAN, *MOUNTED, "--registration", FIRST, "--certificate", file)
    assert code == 1
    assert "not written, only an admissible verdict has a proof" in err
    assert not file.exists()


def test_what_is_no_proof_is_refused(cutgate, proof):
    proof.write_bytes(proof.read_bytes()[:-1])
    code, out, err = cutgate("recheck", proof, PLAN, *MOUNTED, "--registration", SECOND)
    assert (code, out) == (2, "")
    assert "199 bytes" in err
    assert "write it anew" in err


def test_the_published_march_has_no_proof_and_a_file_that_cannot_be_written_is_named(cutgate, tmp_path):
    both = ["verify", PLAN, *MOUNTED, "--registration", SECOND, "--certificate"]
    code, _, err = cutgate(*both, tmp_path / "proof", "--method", "stocco")
    assert code == 2
    assert "proves nothing between its steps" in err
    code, _, err = cutgate(*both, tmp_path)
    assert code == 2
    assert f"{tmp_path}: cannot be written" in " ".join(err.split())
