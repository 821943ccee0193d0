"""Expressions against an evaluation of their own kind, parameters, and what neither defines."""

import math
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.plan.toolpath.expressions import (
    BRACKETS_MAX,
    LOCAL_MAX,
    MACHINE_FIRST,
    NAMES_MAX,
    PARAMETERS_MAX,
    GcodeError,
    Parameters,
    Scanner,
    integer,
)

OPERATIONS = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "MOD": lambda a, b: a % abs(b),
    "EQ": lambda a, b: abs(a - b) < 1e-4,
    "NE": lambda a, b: not abs(a - b) < 1e-4,
    "GT": lambda a, b: a > b,
    "GE": lambda a, b: a >= b,
    "LT": lambda a, b: a < b,
    "LE": lambda a, b: a <= b,
    "AND": lambda a, b: a != 0 and b != 0,
    "OR": lambda a, b: a != 0 or b != 0,
    "XOR": lambda a, b: (a != 0) is not (b != 0),
}
LEVELS = (("AND", "OR", "XOR"), ("EQ", "NE", "GT", "GE", "LT", "LE"), ("+", "-"), ("*", "/", "MOD"))
FUNCTIONS = {
    "ABS": abs,
    "COS": lambda x: math.cos(math.radians(x)),
    "SIN": lambda x: math.sin(math.radians(x)),
    "FIX": math.floor,
    "FUP": lambda x: -math.floor(-x),
    "ROUND": lambda x: math.copysign(math.floor(abs(x) + 0.5), x),
    "EXP": math.exp,
}


@dataclass(frozen=True)
class Term:
    """Text, the value that it has, and how tightly its outermost operator binds (4: it has none)."""

    text: str
    value: float
    level: int = 4


def _joined(parts: tuple[Term, str, Term]) -> Term:
    """Brackets only where precedence, or the order from left to right, asks for them."""
    left, operator, right = parts
    level = next(number for number, names in enumerate(LEVELS) if operator in names)
    first = left.text if left.level >= level else f"[{left.text}]"
    second = right.text if right.level > level else f"[{right.text}]"
    try:
        value = float(OPERATIONS[operator](left.value, right.value))
    except ZeroDivisionError:
        return left
    return Term(first + operator + second, value, level)


def _of_function(parts: tuple[str, Term]) -> Term:
    name, argument = parts
    if not abs(argument.value) < {"EXP": 9, "SIN": 1e5, "COS": 1e5}.get(name, math.inf):
        return argument  # the smallest difference of an argument would be seen
    return Term(f"{name}[{argument.text}]", float(FUNCTIONS[name](argument.value)))


LEAVES = st.integers(-9999, 9999).map(lambda n: Term(f"{n / 100:.2f}", n / 100))
TERMS = st.recursive(
    LEAVES,
    lambda inner: (
        st.tuples(inner, st.sampled_from(sorted(OPERATIONS)), inner).map(_joined)
        | st.tuples(st.sampled_from(sorted(FUNCTIONS)), inner).map(_of_function)
        | inner.map(lambda term: Term(f"-[{term.text}]", -term.value))
    ),
    max_leaves=12,
).filter(lambda term: math.isfinite(term.value))


def value_of(text: str, parameters: Parameters | None = None) -> float:
    scanner = Scanner(text, parameters or Parameters())
    value = scanner.value()
    assert scanner.ended()
    return value


@given(TERMS)
def test_an_expression_has_the_value_that_its_tree_has(term: Term):
    assert value_of(f"[{term.text}]") == pytest.approx(term.value, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2),
        ("-.5", -0.5),
        ("+3.", 3),
        ("[2**3**2]", 64),
        ("[2**-1]", 0.5),
        ("[8/2**2]", 2),
        ("[3*2**2]", 12),
        ("[7MOD2**2]", 3),
        ("[-7MOD3]", 2),
        ("[7MOD-3]", 1),
        ("[1EQ1.00005]", 1),
        ("[1EQ1.0002]", 0),
        ("[1NE1.00005]", 0),
        ("[1LT2+3]", 1),
        ("[1AND1OR0]", 1),
        ("[0OR1AND0]", 0),
        ("[2+3*4**2-1]", 49),
        ("ROUND[-2.5]", -3),
        ("ROUND[2.5]", 3),
        ("FIX[-2.5]", -3),
        ("FUP[-2.5]", -2),
        ("ATAN[1]/[-1]", 135),
        ("ACOS[0]", 90),
        ("ASIN[-1]", -90),
        ("TAN[45]", 1),
        ("LN[1]", 0),
        ("SQRT[[3]*[3]]", 3),
        ("-SIN[30]", -0.5),
        ("--2", 2),
        ("+[1]", 1),
    ],
)
def test_values_that_linuxcnc_gives(text: str, value: float):
    assert value_of(text) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("[1/0]", "1 / 0"),
        ("[1MOD0]", "1 MOD 0"),
        ("[-8**0.5]", "-8 ** 0.5"),
        ("[0**-1]", "0 ** -1"),
        ("[9**9**9**9**9]", "**"),
        ("[9**999]", "9 ** 999"),
        ("SQRT[-1]", "SQRT[-1]"),
        ("LN[0]", "LN[0]"),
        ("ASIN[2]", "ASIN[2]"),
        ("EXP[9999]", "EXP[9999]"),
        ("[1+]", '"]"'),
        ("[1", "the end"),
        ("[1 2]", '" 2]"'),
        ("SIN2", '"2"'),
        ("ATAN[1]", "the end"),
        ("XYZ", '"XYZ"'),
        ("", "the end"),
        ("1E5", None),
        ("[" + "9" * 400 + "]", "inf"),
        ("EXISTS[#5]", "EXISTS[#5]"),
        ("EXISTS[#<_A>]", "EXISTS[#<_a>]"),
        ("EXISTS[2]", '"[2]"'),
        ("#<>", '"<>"'),
        ("#<" + "A" * 61 + ">", '"<AA'),
        ("#1.5", "1.5"),
        ("#0", "#0"),
        ("#-1", "#-1"),
        (f"#{PARAMETERS_MAX + 1}", "#5603"),
        (f"#{MACHINE_FIRST}", f"#{MACHINE_FIRST}"),
        ("#5420", "#5420"),
        ("#7", "#7"),
        ("#100", "#100"),
        ("#<A>", "#<a>"),
        ("#<_X>", "#<_x>"),
    ],
)
def test_what_has_no_value_is_refused(text: str, found: str | None):
    scanner = Scanner(text, Parameters())
    if found is None:  # a number ends before the exponent: LinuxCNC has none
        assert scanner.value() == 1
        assert scanner.rest == "E5"
        return
    with pytest.raises(GcodeError) as caught:
        scanner.value()
    assert found in caught.value.found
    assert caught.value.bound
    assert caught.value.remedy


def test_brackets_nest_so_deep_and_no_deeper():
    inside, outside = "[" * BRACKETS_MAX, "[" * (BRACKETS_MAX + 1)
    assert value_of(f"{inside}1{']' * BRACKETS_MAX}") == 1
    with pytest.raises(GcodeError, match="levels of brackets"):
        value_of(outside + "1" + "]" * (BRACKETS_MAX + 1))


def test_signs_nest_no_deeper_either():
    with pytest.raises(GcodeError, match="levels of brackets"):
        value_of("-" * 10_000 + "[1]")


def test_a_parameter_is_found_by_its_number_by_an_expression_and_by_its_name():
    parameters = Parameters()
    parameters.set(100, 7.0)
    parameters.set(101, 100.0)
    parameters.set("a b", 2.0)
    assert value_of("#100", parameters) == 7
    assert value_of("##101", parameters) == 7
    assert value_of("#[99+1]", parameters) == 7
    assert value_of("#100.00001", parameters) == 7
    assert value_of("#<A B>", parameters) == 2
    assert value_of("EXISTS[#<A B>]", parameters) == 1
    assert value_of("EXISTS[#<C>]", parameters) == 0


def test_a_subroutine_has_parameters_of_its_own():
    parameters = Parameters()
    for key in (1, LOCAL_MAX, LOCAL_MAX + 1, "own", "_all"):
        parameters.set(key, 5.0)
    parameters.enter([1.0, 2.0])
    assert [parameters.number(n) for n in (1, 2, 3, LOCAL_MAX)] == [1, 2, 0, 0]
    assert parameters.number(LOCAL_MAX + 1) == 5
    assert parameters.named("_all") == 5
    assert not parameters.exists("own")
    parameters.set(1, 9.0)
    parameters.set("_all", 6.0)
    parameters.leave(4.0)
    assert parameters.number(1) == 5
    assert parameters.named("_all") == 6
    assert parameters.named("_value") == 4
    assert parameters.named("_value_returned") == 1
    parameters.enter([])
    parameters.leave(None)
    assert (parameters.named("_value"), parameters.named("_value_returned")) == (0, 0)


def test_what_the_machine_keeps_is_not_set():
    for key in (0, MACHINE_FIRST, PARAMETERS_MAX + 1, "_x", "_value"):
        with pytest.raises(GcodeError):
            Parameters().set(key, 1.0)


def test_a_name_that_the_machine_keeps_is_told_from_one_that_is_not_set():
    with pytest.raises(GcodeError, match="the machine keeps it"):
        Parameters().named("_x")
    with pytest.raises(GcodeError, match="set before it is used"):
        Parameters().named("_mine")


def test_names_are_bounded():
    parameters = Parameters()
    for number in range(NAMES_MAX):
        parameters.set(f"n{number}", 0.0)
    parameters.set("n0", 1.0)
    with pytest.raises(GcodeError, match="named parameters"):
        parameters.set("another", 0.0)


@given(st.floats(-1e6, 1e6))
def test_an_integer_is_one_within_a_ten_thousandth(value: float):
    nearest = math.floor(value + 0.5)
    if abs(value - nearest) <= 1e-4:
        assert integer(value, "n") == nearest
    else:
        with pytest.raises(GcodeError):
            integer(value, "n")
