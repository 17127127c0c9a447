# SPDX-License-Identifier: Apache-2.0
"""Mutation operators by class: those of Cosmic Ray that resemble slips, and six of our own.

Cosmic Ray replaces operators and keywords. It neither swaps arguments nor drops a term, a statement
or a condition, which are the slips that reviews of this code have found; and it changes numbers by
one, which for most is no slip but another choice.
"""

import ast
from collections.abc import Iterator
from typing import Any

import parso.python.tree as tree
from cosmic_ray.operators.operator import Example, Operator
from cosmic_ray.operators.provider import OperatorProvider


class _Own(Operator):
    """An operator that changes the children of a node."""

    def choices(self, node: Any) -> Iterator[tuple[Any, Any]]:
        """Yield what the operator can do to a node: a key for `change`, and the node to report.

        Args:
            node: A node of the syntax tree.
        """
        raise NotImplementedError

    def change(self, node: Any, key: Any) -> None:
        """Change a node in place.

        Args:
            node: The node.
            key: One that `choices` yielded.
        """
        raise NotImplementedError

    def mutation_positions(self, node: Any) -> list[tuple[Any, Any]]:
        """Return the position of each possible change; see Cosmic Ray."""
        return [(shown.start_pos, shown.end_pos) for _, shown in self.choices(node)]

    def mutate(self, node: Any, index: int) -> Any:
        """Make one of the possible changes; see Cosmic Ray."""
        key, _ = list(self.choices(node))[index]
        self.change(node, key)
        return node

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Return no examples, which only tests of Cosmic Ray itself use."""
        return ()


class SwapArguments(_Own):
    """Swaps two neighbouring positional arguments of a call."""

    def choices(self, node: Any) -> Iterator[tuple[Any, Any]]:
        """See `_Own`."""
        called = node.parent.get_previous_sibling() if node.type == "arglist" else None
        if called is None or called.get_code().strip() in ("min", "max"):  # in any order
            return
        for i in range(0, len(node.children) - 2, 2):
            pair = node.children[i], node.children[i + 2]
            if any(one.type == "argument" or one.type == "operator" for one in pair):
                continue  # a keyword, or unpacking
            if pair[0].get_code().strip() != pair[1].get_code().strip():
                yield i, pair[0]

    def change(self, node: Any, key: Any) -> None:
        """See `_Own`."""
        children = node.children
        children[key], children[key + 2] = children[key + 2], children[key]


def _drop(node: Any, index: int) -> None:
    """Remove an operand with the operator before it, or after it where it is the first."""
    first = max(index - 1, 0)
    prefix = node.children[first].get_first_leaf().prefix
    del node.children[first : first + 2]
    if first == 0:
        node.children[0].get_first_leaf().prefix = prefix


class DropTerm(_Own):
    """Drops a term of a sum or a factor of a product."""

    kinds: tuple[str, ...] = ("arith_expr", "term")

    def choices(self, node: Any) -> Iterator[tuple[Any, Any]]:
        """See `_Own`."""
        if node.type in self.kinds:
            yield from ((i, node.children[i]) for i in range(0, len(node.children), 2))

    def change(self, node: Any, key: Any) -> None:
        """See `_Own`."""
        _drop(node, key)


class DropCondition(DropTerm):
    """Drops an operand of a conjunction or a disjunction."""

    kinds = ("and_test", "or_test")


class FixCondition(_Own):
    """Makes the condition of an if always true or always false."""

    def choices(self, node: Any) -> Iterator[tuple[Any, Any]]:
        """See `_Own`."""
        if node.type == "if_stmt" and "__name__" not in node.children[1].get_code():
            yield from ((value, node.children[1]) for value in ("True", "False"))

    def change(self, node: Any, key: Any) -> None:
        """See `_Own`."""
        node.children[1] = tree.Keyword(key, node.children[1].start_pos, " ")


class DropStatement(_Own):
    """Drops a call, a raise, a deletion, or an assignment to something other than a local name."""

    def choices(self, node: Any) -> Iterator[tuple[Any, Any]]:
        """See `_Own`."""
        if node.type != "simple_stmt":
            return
        what = node.children[0]
        assigned = what.type == "expr_stmt" and what.children[1].type == "operator"
        if assigned and what.children[0].type == "name":  # without it the name is not known
            assigned = what.children[1].value != "="
        called = what.type == "atom_expr" and what.children[-1].get_code().startswith("(")
        if assigned or called or what.type in ("raise_stmt", "del_stmt"):
            yield 0, what

    def change(self, node: Any, key: Any) -> None:
        """See `_Own`."""
        leaf = node.children[key].get_first_leaf()
        node.children[key] = tree.Keyword("pass", leaf.start_pos, leaf.prefix)


class ChangeNumber(_Own):
    """Doubles a number, or adds one to a small integer and to zero."""

    def choices(self, node: Any) -> Iterator[tuple[Any, Any]]:
        """See `_Own`."""
        if node.type == "number":
            yield 0, node

    def change(self, node: Any, key: Any) -> None:
        """See `_Own`."""
        value = ast.literal_eval(node.value)
        small = value == 0 or (isinstance(value, int) and value < 10)
        node.value = repr(value + 1 if small else 2 * value)


def _replace(*pairs: tuple[str, str], kind: str) -> list[str]:
    """Return names of Cosmic Ray's operators that replace the first of each pair, and back."""
    both = [*pairs, *((b, a) for a, b in pairs)]
    return [f"Replace{kind}Operator_{a}_{b}" for a, b in both]


CLASSES: dict[str, list[str]] = {
    "sign": [*_replace(("Add", "Sub"), kind="Binary"), "ReplaceUnaryOperator_Delete_USub"],
    "factor": _replace(("Mul", "Div"), kind="Binary"),
    "boundary": _replace(("Lt", "LtE"), ("Gt", "GtE"), kind="Comparison"),
    "comparison": _replace(
        ("Lt", "Gt"), ("LtE", "GtE"), ("Eq", "NotEq"), ("Is", "IsNot"), kind="Comparison"
    ),
    "condition": [
        "AddNot",
        "ReplaceAndWithOr",
        "ReplaceOrWithAnd",
        "ReplaceUnaryOperator_Delete_Not",
        "DropCondition",
        "FixCondition",
    ],
    "arguments": ["SwapArguments"],
    "term": ["DropTerm"],
    "statement": ["DropStatement"],
    "number": ["ChangeNumber"],
    "truth value": ["ReplaceTrueWithFalse", "ReplaceFalseWithTrue"],
    "loop and exception": [
        "ReplaceBreakWithContinue",
        "ReplaceContinueWithBreak",
        "ZeroIterationForLoop",
        "ExceptionReplacer",
    ],
}
"""Operators by class of fault."""

_OWN = (SwapArguments, DropTerm, DropCondition, FixCondition, DropStatement, ChangeNumber)
_THEIRS = OperatorProvider()
OPERATORS: dict[str, Operator] = {own.__name__: own() for own in _OWN}
OPERATORS |= {
    name: _THEIRS[name]() for names in CLASSES.values() for name in names if name not in OPERATORS
}
