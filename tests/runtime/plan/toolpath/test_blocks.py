"""A line of G-code: its words, its assignments, its comments, and what is none of them."""

import pytest

from cutgate.runtime.plan.toolpath.blocks import LINE_MAX, GcodeBlock, bare, read_block
from cutgate.runtime.plan.toolpath.expressions import GcodeError, Parameters


def block_of(line: str, parameters: Parameters | None = None) -> GcodeBlock:
    return read_block(bare(line), parameters or Parameters())


@pytest.mark.parametrize(
    ("line", "codes", "values"),
    [
        ("", [], {}),
        ("  (all a comment) ; and another ( one", [], {}),
        ("g1x 2 . 5\tY-.5Z+3.", ["G1"], {"X": 2.5, "Y": -0.5, "Z": 3.0}),
        ("N12 G01 (to (X) X1", None, "a parenthesis"),
        ("N12.5 G43.1 M06 X[1+1]", ["G43.1", "M6"], {"X": 2.0}),
        ("G[1+1] X-[2]", ["G2"], {"X": -2.0}),
        ("G1 (a;b) X1", ["G1"], {"X": 1.0}),
        ("G1 X1\r", ["G1"], {"X": 1.0}),
        ("(abort, no) G1", None, "(ABORT,...)"),
        ("(msg, abort, no) G1", ["G1"], {}),
        ("G1 (open", None, "a parenthesis"),
        ("G1 shut)", None, "a parenthesis"),
        ("G1 X1 X2", None, "two X words"),
        ("/G1 X1", None, "block delete /"),
        ("G1 U1", None, "U word"),
        ("G1 O5", None, "O word"),
        ("G1 X1 N5", None, "N word"),
        ("G1 !", None, '"!"'),
        ("G1 X", None, "the end of the line"),
        ("G1 X1,5", None, '",5"'),
        ("G1 X1e3", None, "E word"),
        ("G1 X²", None, '"²"'),
        ("G1 Ÿ1 (ü)", None, '"Ÿ"'),
        ("G1 (ü)", ["G1"], {}),
        ("G1.05", None, "G1.05"),
        ("M1000", None, "M1000"),
        ("G-1", None, "G-1"),
        ("G" + "9" * 200, None, "G1e+200"),
        ("X" * (LINE_MAX + 1), None, f"{LINE_MAX + 1} characters"),
        ("#1", None, "the end of the line"),
        ("#5220=1", None, "#5220"),
    ],
)
def test_words_of_a_line(line: str, codes: list[str] | None, values: object):
    if codes is None:
        with pytest.raises(GcodeError) as caught:
            block_of(line)
        assert str(values) in caught.value.found
        return
    block = block_of(line)
    assert block.codes == codes
    assert block.values == values


def test_assignments_hold_from_the_next_line_on():
    parameters = Parameters()
    parameters.set(100, 1.0)
    block = block_of("#100=5 #101=#100 X#100 #<a>=[2*#100]", parameters)
    assert block.values == {"X": 1.0}
    assert (parameters.number(100), parameters.number(101), parameters.named("a")) == (5, 1, 2)


def test_a_letter_is_used_once():
    block = block_of("X1")
    assert block.take("X") == 1.0
    assert block.take("X") is None
    assert block_of("P2").need("P", "G4") == 2.0
    with pytest.raises(GcodeError, match="G4 without P"):
        block.need("P", "G4")
