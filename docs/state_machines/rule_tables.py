"""The controller's rules as tables: each refusal, and the expression that decides it."""

import ast
import inspect
import re
from collections.abc import Callable
from functools import cache
from textwrap import dedent
from typing import Any

from cutgate.firmware_sim import rules
from docs.state_machines.tables import table


@cache
def _rule_lambdas() -> dict[int, str]:
    """The conditions of the lambdas in the rules' module, by line."""
    tree = ast.parse(inspect.getsource(rules))
    return {node.lineno: ast.unparse(node.body) for node in ast.walk(tree) if isinstance(node, ast.Lambda)}


def condition(holds: Callable[..., Any]) -> str:
    """What a rule demands: the expression that it returns at last, and its docstring."""
    if holds.__name__ == "<lambda>":
        text = _rule_lambdas()[holds.__code__.co_firstlineno]
    else:
        body = ast.parse(dedent(inspect.getsource(holds))).body[0]
        returned = (node for node in ast.walk(body) if isinstance(node, ast.Return))
        text = ast.unparse(max(returned, key=lambda node: node.lineno).value or body)
    text = re.sub(r"\b_(\w+)\((case|c)(, purpose)?\)", r"\1", text)  # a part of a rule: its name says it
    words = (holds.__doc__ or "").partition("\n")[0]
    return f"`{re.sub(r'(case|c)[.](controller[.])?', '', text)}` {words}".rstrip()


def rule_table(which: tuple[rules.Rule, ...]) -> str:
    """One request's rules in the order in which they are judged."""
    head = ("", "refusal", "code", "required")
    return table(
        head,
        (
            (str(number), refusal.name, str(int(refusal)), condition(holds))
            for number, (refusal, holds) in enumerate(which, start=1)
        ),
    )
