"""Small, plausible mistakes in one module: each mutant is the module's source with one of them made.

Comparisons flip, conditions are negated, ``and`` and ``or`` change places, numbers grow by one, truth values flip;
entries of tables and keyword arguments vanish, and so do early returns, raises and calls made for their effect.
Strings and assertions are left alone: the ones are for people, the others for the type checker.
"""

import ast
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Final

FLIPPED: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
ENTRIES_MIN: Final = 2
"""A table of one entry is no table."""


@dataclass(frozen=True)
class Mutant:
    """One mistake: where, what it makes of what, and the whole module with it."""

    name: str
    source: str


def mutants(source: str) -> list[Mutant]:
    """Every mutant of a module, in the order of its source; names are unique and outlive moved lines."""
    tree = ast.parse(source)
    found: list[Mutant] = []
    met: dict[str, int] = {}
    for place, node in enumerate(ast.walk(tree)):
        for change in _changes(node):
            copy = deepcopy(tree)
            twin = next(other for number, other in enumerate(ast.walk(copy)) if number == place)
            where, before = _where(tree, node), _short(node)
            change(twin)
            name = f"{where}: {before} -> {_short(twin)}"
            met[name] = met.get(name, 0) + 1
            numbered = name if met[name] == 1 else f"{name} ({met[name]})"
            found.append(Mutant(numbered, ast.unparse(ast.fix_missing_locations(copy))))
    return found


def _changes(node: ast.AST) -> Iterator[Callable[[Any], None]]:  # noqa: C901, PLR0912 - one case a kind of mistake
    match node:
        case ast.Compare(ops=ops):
            for number, op in enumerate(ops):
                yield lambda twin, number=number, op=op: _set(twin.ops, number, FLIPPED[type(op)]())
        case ast.BoolOp(op=op):
            yield lambda twin, op=op: setattr(twin, "op", ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.If(test=test) | ast.IfExp(test=test) if not isinstance(test, ast.Compare):
            yield lambda twin: setattr(twin, "test", ast.UnaryOp(ast.Not(), twin.test))
        case ast.Constant(value=bool() as value):
            yield lambda twin, value=value: setattr(twin, "value", not value)
        case ast.Constant(value=int() | float() as value):
            yield lambda twin, value=value: setattr(twin, "value", value + 1)
        case ast.Dict(keys=keys) if len(keys) >= ENTRIES_MIN:
            for number in range(len(keys)):
                yield lambda twin, number=number: (twin.keys.pop(number), twin.values.pop(number))  # type: ignore[func-returns-value]
        case ast.Set(elts=elts) if len(elts) >= ENTRIES_MIN:
            for number in range(len(elts)):
                yield lambda twin, number=number: twin.elts.pop(number)
        case ast.AnnAssign(value=ast.Tuple(elts=elts)) if len(elts) >= ENTRIES_MIN:
            for number in range(len(elts)):
                yield lambda twin, number=number: twin.value.elts.pop(number)
        case ast.Call(keywords=keywords):
            for number, keyword in enumerate(keywords):
                if keyword.arg:
                    yield lambda twin, number=number: twin.keywords.pop(number)
    yield from _deletions(node)


def _deletions(node: ast.AST) -> Iterator[Callable[[Any], None]]:
    """Early returns, raises and calls made for their effect."""
    if isinstance(node, ast.If) and isinstance(node.body[-1], ast.Return | ast.Raise):
        yield lambda twin: _set(twin.body, -1, ast.Pass())
    for number, statement in enumerate(getattr(node, "body", []) if isinstance(node, ast.stmt) else []):
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
            yield lambda twin, number=number: _set(twin.body, number, ast.Pass())


def _set(items: list[Any], number: int, value: Any) -> None:
    items[number] = value


def _short(node: ast.AST) -> str:
    """The code in one line; of a statement with a body, head and last statement."""
    if isinstance(node, ast.If):
        return f"if {ast.unparse(node.test)}: {ast.unparse(node.body[-1])}"
    if isinstance(node, ast.FunctionDef | ast.With | ast.Try | ast.For | ast.While | ast.ClassDef):
        return "; ".join(ast.unparse(statement).partition("\n")[0] for statement in node.body)
    return " ".join(ast.unparse(node).split())


def _where(tree: ast.Module, node: ast.AST) -> str:
    """The function, class or name that the node stands in."""
    for statement in tree.body:
        if any(inner is node for inner in ast.walk(statement)):
            if isinstance(statement, ast.Assign):
                return ast.unparse(statement.targets[0])
            if isinstance(statement, ast.AnnAssign):
                return ast.unparse(statement.target)
            return str(getattr(statement, "name", "module"))
    return "module"
