"""Which lines are executed, in which order, how often; and which programs have no order."""

import pytest

from cutgate.runtime.plan.toolpath.blocks import read_block
from cutgate.runtime.plan.toolpath.expressions import GcodeError, Parameters
from cutgate.runtime.plan.toolpath.program import NESTING_MAX, Program


def executed(text: str, work: int = 100_000) -> list[float]:
    """The X words of the lines that are executed, until M2; a refusal says its line."""
    parameters, values = Parameters(), []
    program = None
    try:
        program = Program(text.split("\n"), parameters, work)
        for line in program.blocks():
            block = read_block(line, parameters)
            if "X" in block.values:
                values.append(block.values["X"])
            if "M2" in block.codes:
                break
    except GcodeError as error:
        error.line = error.line or program.index + 1
        raise
    return values


def refused(text: str, line: int, part: str) -> None:
    with pytest.raises(GcodeError) as caught:
        executed(text)
    error = caught.value
    assert error.line == line
    assert part in f"{error.found}, {error.bound}; {error.remedy}"


BRANCHES = """#1={}
o1 if [#1 eq 1]
X1
o1 elseif [#1 eq 2]
X2
o1 elseif [#1 eq 3]
X3
o1 else
X4
o1 endif
X9
M2"""


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_one_branch_is_executed(number: int):
    assert executed(BRANCHES.format(number)) == [number, 9]


def test_no_branch_is_executed_where_none_holds():
    assert executed("o1 if [0]\nX1\no1 elseif [0]\nX2\no1 endif\nX3\nM2") == [3]


@pytest.mark.parametrize(
    ("loop", "values"),
    [
        ("o1 while [#1 lt 3]\n#1=[#1+1]\nX#1\no1 endwhile", [1, 2, 3]),
        ("o1 while [0]\nX1\no1 endwhile", []),
        ("o1 do\n#1=[#1+1]\nX#1\no1 while [#1 lt 3]", [1, 2, 3]),
        ("o1 do\n#1=[#1+1]\nX#1\no1 while [0]", [1]),
        ("o1 repeat [3]\n#1=[#1+1]\nX#1\no1 endrepeat", [1, 2, 3]),
        ("o1 repeat [0]\nX1\no1 endrepeat", []),
        ("o1 repeat [2]\no2 repeat [2]\n#1=[#1+1]\nX#1\no2 endrepeat\no1 endrepeat", [1, 2, 3, 4]),
        (
            (
                "o1 while [#1 lt 5]\n#1=[#1+1]\no2 if [#1 eq 2]\no1 continue\no2 endif\n"
                "o3 if [#1 eq 4]\no1 break\no3 endif\nX#1\no1 endwhile"
            ),
            [1, 3],
        ),
        (
            (
                "o1 do\n#1=[#1+1]\no2 if [#1 eq 2]\no1 continue\no2 endif\n"
                "o3 if [#1 eq 4]\no1 break\no3 endif\nX#1\no1 while [#1 lt 9]"
            ),
            [1, 3],
        ),
        ("O<a loop> REPEAT [2] (twice)\nX1\n o < aloop > endrepeat ; end", [1, 1]),
        ("o001 repeat [2]\nX1\no1 endrepeat", [1, 1]),
    ],
)
def test_loops(loop: str, values: list[float]):
    assert executed(f"#1=0\n{loop}\nX9\nM2") == [*values, 9]


SUBS = """o1 sub
X#1
o2 if [#1 le 0]
o1 return [#2]
o2 endif
o1 call [#1-1] [7]
X#1
o1 endsub
o3 sub
X30
o3 endsub [5]
o4 sub
o4 endsub
"""


def test_subroutines_call_themselves_and_return_values():
    assert executed(f"{SUBS}o1 call [2]\nX#<_value>\nM2") == [2, 1, 0, 1, 2, 0]
    assert executed(f"{SUBS}o3 call\nX#<_value>\nX#<_value_returned>\nM2") == [30, 5, 1]
    assert executed(f"{SUBS}o4 call\nX#<_value_returned>\nM2") == [0]
    assert executed(f"{SUBS}o1 call [0] [8]\nX#<_value>\nM2") == [0, 8]


def test_a_call_within_a_loop_leaves_its_count_alone():
    sub = "o5 sub\no6 repeat [2]\nX1\no6 endrepeat\no5 endsub\n"
    assert executed(f"{sub}o6 repeat [2]\no5 call\no6 endrepeat\nM2") == [1, 1, 1, 1]


def test_calls_nest_so_deep_and_no_deeper():
    assert len(executed(f"{SUBS}o1 call [{NESTING_MAX - 1}]\nM2")) == 2 * NESTING_MAX - 1
    refused(f"{SUBS}o1 call [{NESTING_MAX}]\nM2", 6, f"<= {NESTING_MAX}")


def test_percent_signs_enclose_the_program():
    assert executed("\n %\nX1\n%\nX2 and anything\no1 endif") == [1]
    assert executed("%\nX1\nM2\nX2") == [1]


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("X1", 1, "M2, M30 or a second %"),
        ("", 1, "cut off"),
        ("%\nX1\n", 3, "cut off"),
        ("X1\n%\nM2", 2, '"%"'),
        ("o1 if [1]\nX1\nM2", 1, "O1 IF without its end"),
        ("o1 if [1]\no1 else\no1 elseif [1]\no1 endif", 3, "O1 ELSEIF"),
        ("o1 if [1]\no2 endif", 2, "O2 ENDIF"),
        ("o1 while [1]\no2 if [1]\no1 endwhile\no2 endif", 3, "O1 ENDWHILE"),
        ("o1 endwhile", 1, "after WHILE"),
        ("o1 endsub", 1, "after SUB"),
        ("o1 else", 1, "after ELSEIF or IF"),
        ("o1 return", 1, "within SUB"),
        ("o1 repeat [1]\no2 break\no1 endrepeat", 2, "within DO or REPEAT or WHILE"),
        ("o1 if [1]\no2 sub\no2 endsub\no1 endif", 2, "outside of all"),
        ("o1 sub\no1 endsub\no1 sub\no1 endsub", 3, "a second SUB O1"),
        ("o1 if [1]\no1 endif\no1 if [1]\no1 endif", 3, "a second IF O1"),
        ("o1 call\nM2", 1, "defines above the call"),
        ("o<file> call\nM2", 1, "O<FILE>"),
        ("o1 sub\no1 endsub\no1 call" + " [1]" * 31, 3, "31 arguments"),
        ("o1 sub\no1 endsub\no1 call 5", 3, '"["'),
        ("o1 if 1\no1 endif", 1, '"["'),
        ("o1 if [1] X1\no1 endif", 1, "nothing after the expression"),
        ("o1 if [0]\no1 elseif [1/0]\no1 endif", 2, "1 / 0"),
        ("o1 if [1]\no1 elseif [1/0]\no1 endif", 2, "1 / 0"),
        ("o1 else X1", 1, "after ELSE"),
        ("o1 repeat [1.5]\no1 endrepeat", 1, "1.5"),
        ("o1 repeat [-1]\no1 endrepeat", 1, "REPEAT [-1]"),
        ("o1 repeat [1e9]\no1 endrepeat", 1, '"]"'),
        ("o#1 if [1]\no1 endif", 1, "O, a number or <name>"),
        ("o1 jump", 1, "O1JUMP"),
        ("O1001 (a part)", 1, "take out the program number"),
        ("o1 if [1] (open\no1 endif", 1, "parenthesis"),
        ("\n".join(f"o{n} if [1]" for n in range(NESTING_MAX + 1)), NESTING_MAX + 1, "over 10 levels"),
        ("o1 repeat [2]\no1 break\no1 endrepeat", 2, "of a REPEAT"),
        ("o1 while [1]\no1 break\no1 endwhile\no2 do\no2 while [0]", 2, "without DO loops"),
        ("o1 do\no1 continue\no1 while [0]\no2 repeat [1]\no2 endrepeat", 2, "without REPEAT loops"),
        ("o1 do\no1 continue\no2 do\no2 while [0]\no1 while [0]", 3, "no loop between"),
        ("o1 while [1]\no1 endwhile", 1, "does a loop end?"),
        ("o1 do\no1 while [1]", 2, "does a loop end?"),
        ("o1 repeat [999999999]\no1 endrepeat", 2, "does a loop end?"),
    ],
)
def test_what_has_no_order_is_refused(text: str, line: int, part: str):
    refused(text, line, part)


def test_the_work_is_bounded_by_characters():
    loop = "#1=0\no1 while [#1 lt {}]\n#1=[#1+1]\no1 endwhile\nM2"
    assert executed(loop.format(50), 10_000) == []
    with pytest.raises(GcodeError, match="more characters"):
        executed(loop.format(1000), 10_000)
