"""Small, plausible mistakes in one module: each mutant is the module's syntax tree with one of them made.

Each operator below makes one kind of mistake; its docstring says which. Strings, annotations and assertions are left
alone: the first are for people, the others for the type checker.
"""

import ast
import pickle
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

FLIPPED: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
SWAPPED: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.FloorDiv, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv, ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr, ast.BitXor: ast.BitOr,
}  # fmt: skip
ENTRIES_MIN: Final = 2
"""A table of one entry is no table."""

Change = Callable[[Any], Any]
"""Makes the mistake in the node it is given."""


@dataclass(frozen=True)
class Mutant:
    """One mistake: where, what it makes of what, of which kind, and the whole module with it.

    Every line keeps its number, so that a function without the mistake compiles to what it was.
    """

    name: str
    kind: str
    tree: ast.Module

    @property
    def source(self) -> str:
        """The module as it would be written."""
        return ast.unparse(self.tree)


def mutants(source: str) -> list[Mutant]:
    """Every mutant of a module, in the order of its source; names are unique and outlive moved lines."""
    tree = ast.parse(source)
    found: list[Mutant] = []
    met: dict[str, int] = {}
    for number, statement in enumerate(tree.body):
        for place in _walk(statement):
            for kind, operator in OPERATORS.items():
                for change in operator(place.node):
                    twin = pickle.loads(pickle.dumps(place.node))  # noqa: S301 - our own; faster than deepcopy
                    change(twin)
                    name = f"{place.where}: {_short(place.node)} -> {_short(twin)}"
                    met[name] = met.get(name, 0) + 1
                    numbered = name if met[name] == 1 else f"{name} ({met[name]})"
                    body = [*tree.body[:number], _with(twin, place), *tree.body[number + 1 :]]
                    found.append(Mutant(numbered, kind, ast.Module(body, [])))
    return found


class _Place(NamedTuple):
    """A node, where it stands for people, and where in its parent: field, and index where that is a list."""

    where: str
    node: ast.AST
    parent: "_Place | None" = None
    field: str = ""
    index: int | None = None


def _walk(statement: ast.stmt) -> list[_Place]:
    """Every node but those in annotations and assertions, outer ones first."""
    places = [_Place(_name(statement), statement)]
    for place in places:
        for field, value in ast.iter_fields(place.node):
            if field in {"annotation", "returns"}:
                continue
            inside = enumerate(value) if isinstance(value, list) else [(None, value)]
            for index, inner in inside:
                if isinstance(inner, ast.AST) and not isinstance(inner, ast.Assert):
                    method = isinstance(place.node, ast.ClassDef) and isinstance(inner, ast.FunctionDef)
                    where = f"{place.where}.{_name(inner)}" if method else place.where
                    places.append(_Place(where, inner, place, field, index))
    return places


def _with(twin: ast.AST, place: _Place) -> Any:
    """The statement with a twin in this place: what lies around it is copied, everything else shared."""
    _locate(twin, place)
    while place.parent is not None:
        around = copy(place.parent.node)
        if place.index is None:
            setattr(around, place.field, twin)
        else:
            items = list(getattr(around, place.field))
            items[place.index] = twin
            setattr(around, place.field, items)
        twin, place = around, place.parent
    return twin


def _locate(twin: ast.AST, place: _Place) -> None:
    """Give what is new in it the line of what it stands in."""
    known = place
    while known.parent is not None and not hasattr(known.node, "lineno"):
        known = known.parent
    for node in ast.walk(twin):
        if isinstance(node, ast.expr | ast.stmt) and not hasattr(node, "lineno"):
            ast.copy_location(node, known.node)


# ---------------------------------------------------------------- the operators


def comparison(node: ast.AST) -> Iterator[Change]:
    """A comparison is flipped, or its bound goes to the other side."""
    if isinstance(node, ast.Compare):
        for number, op in enumerate(node.ops):
            yield lambda twin, number=number, op=op: _put(twin.ops, number, FLIPPED[type(op)]())


def connective(node: ast.AST) -> Iterator[Change]:
    """``and`` and ``or`` change places."""
    if isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield lambda twin: setattr(twin, "op", other)


def negation(node: ast.AST) -> Iterator[Change]:
    """A condition that is no comparison is negated, what stands beside ``and`` or ``or`` as well; a minus sign is lost."""
    negated = {ast.Not: ast.Not(), ast.USub: ast.USub()}
    match node:
        case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test) if not _own(test):
            yield lambda twin: setattr(twin, "test", ast.UnaryOp(ast.Not(), twin.test))
        case ast.UnaryOp(op=ast.Not() | ast.USub() as op):
            yield lambda twin: setattr(twin, "operand", ast.UnaryOp(negated[type(op)], twin.operand))
        case ast.BoolOp(values=items) | ast.comprehension(ifs=items):
            for number, item in enumerate(items):
                if not _own(item):
                    yield lambda twin, number=number: _negate(
                        twin.values if isinstance(twin, ast.BoolOp) else twin.ifs, number
                    )


def _own(test: ast.expr) -> bool:
    """Whether the expression has mutants of its own that turn it round, or is only a text to be shown."""
    turned = isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not)
    return turned or isinstance(test, ast.Compare | ast.Constant)


def truth(node: ast.AST) -> Iterator[Change]:
    """A truth value flips."""
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield lambda twin: setattr(twin, "value", not twin.value)


def number(node: ast.AST) -> Iterator[Change]:
    """A number grows by one."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield lambda twin: setattr(twin, "value", twin.value + 1)


def arithmetic(node: ast.AST) -> Iterator[Change]:
    """Plus and minus, times and divided, the bits' and and or, and the shifts change places."""
    if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in SWAPPED:
        yield lambda twin: setattr(twin, "op", SWAPPED[type(twin.op)]())


def entry(node: ast.AST) -> Iterator[Change]:
    """An entry of a table or a set vanishes."""
    match node:
        case ast.Dict(keys=entries) | ast.Set(elts=entries):
            pass
        case ast.Assign(value=ast.Tuple(elts=entries)) | ast.AnnAssign(value=ast.Tuple(elts=entries)):
            pass
        case _:
            return
    for place in range(len(entries) if len(entries) >= ENTRIES_MIN else 0):
        yield lambda twin, place=place: [
            column.pop(place) for column in _columns(getattr(twin, "value", twin))
        ]


def _columns(table: ast.AST) -> list[list[Any]]:
    return [table.keys, table.values] if isinstance(table, ast.Dict) else [table.elts]  # type: ignore[attr-defined]


def argument(node: ast.AST) -> Iterator[Change]:
    """A keyword argument is left out."""
    if isinstance(node, ast.Call):
        for place, keyword in enumerate(node.keywords):
            if keyword.arg:
                yield lambda twin, place=place: twin.keywords.pop(place)


def leaving(node: ast.AST) -> Iterator[Change]:
    """An early return or a raise is left out."""
    match node:
        case ast.If(body=body) | ast.match_case(body=body) | ast.ExceptHandler(body=body) if isinstance(
            body[-1], ast.Return | ast.Raise
        ):
            yield lambda twin: _put(twin.body, -1, ast.Pass())


def effect(node: ast.AST) -> Iterator[Change]:
    """A call made for its effect is left out."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield lambda twin: setattr(twin, "value", ast.Constant(...))


def memory(node: ast.AST) -> Iterator[Change]:
    """What is to be remembered in an attribute or an entry is not."""
    match node:
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield lambda twin: _put(twin.targets, 0, ast.Name("_", ast.Store()))
        case ast.AnnAssign(target=ast.Attribute(), value=ast.expr()):
            yield lambda twin: (
                setattr(twin, "target", ast.Name("_", ast.Store())),
                setattr(twin, "simple", 1),
            )


def _put(items: list[Any], place: int, value: Any) -> None:
    items[place] = value


def _negate(items: list[ast.expr], place: int) -> None:
    items[place] = ast.UnaryOp(ast.Not(), items[place])


OPERATORS: Final[dict[str, Callable[[ast.AST], Iterator[Change]]]] = {
    operator.__name__: operator
    for operator in (
        comparison,
        connective,
        negation,
        truth,
        number,
        arithmetic,
        entry,
        argument,
        leaving,
        effect,
        memory,
    )
}
"""Every kind of mistake that is made."""


# ---------------------------------------------------------------- names


def _short(node: ast.AST) -> str:
    """The code in one line; of what has a body, its head and last statement."""
    match node:
        case ast.If():
            return f"if {ast.unparse(node.test)}: {ast.unparse(node.body[-1])}"
        case ast.While():
            return f"while {ast.unparse(node.test)}"
        case ast.match_case():
            return f"case {ast.unparse(node.pattern)}: {ast.unparse(node.body[-1])}"
        case ast.ExceptHandler():
            return f"except {ast.unparse(node.type) if node.type else ''}: {ast.unparse(node.body[-1])}"
    return " ".join(ast.unparse(node).split())


def _name(statement: ast.AST) -> str:
    """The function, class or name that the statement defines."""
    match statement:
        case ast.Assign(targets=[target, *_]) | ast.AnnAssign(target=target):
            return ast.unparse(target)
    return str(getattr(statement, "name", "module"))
