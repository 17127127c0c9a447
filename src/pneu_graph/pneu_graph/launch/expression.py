# SPDX-License-Identifier: Apache-2.0
"""The expressions of ``$(eval ...)``: a small part of Python that can only compute.

Numbers, strings, lists, comparisons, ``and or not in``, arithmetic, ``a if b else c``, the
functions of `math`, and ``abs bool float int len max min round str``. `ros2 launch` allows all of
Python.
"""

import ast
import math
import operator
from collections.abc import Callable
from typing import Any

LONGEST_EXPRESSION = 2000
LARGEST_EXPONENT = 1000.0
LONGEST_RESULT = 100_000

_BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
}
_UNARY: dict[type, Callable[[Any], Any]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_COMPARE: dict[type, Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_MATH = {name: getattr(math, name) for name in dir(math) if not name.startswith("_")}
_CONSTANTS = {name: found for name, found in _MATH.items() if not callable(found)}
_NAMES: dict[str, Any] = {
    **{name: found for name, found in _MATH.items() if name not in ("factorial", "comb", "perm")},
    **{f.__name__: f for f in (abs, bool, float, int, len, max, min, round, str)},
    "true": True,
    "false": False,
}


def evaluate(text: str) -> Any:
    """Returns the value of an expression.

    Args:
        text: The expression.

    Raises:
        ValueError: It is no expression, or uses what is not allowed.
    """
    if len(text) > LONGEST_EXPRESSION:
        raise ValueError(f"is longer than {LONGEST_EXPRESSION} characters")
    try:
        tree = ast.parse(text.strip(), mode="eval")
        return _value(tree.body)
    except SyntaxError as error:
        raise ValueError(f"is no expression ({error.msg})") from None
    except (TypeError, ArithmeticError, RecursionError) as error:
        raise ValueError(f"cannot be computed ({error})") from None


def _value(node: ast.expr) -> Any:
    match node:
        case ast.Constant(value=bool() | int() | float() | str()):
            return node.value
        case ast.Name(id=name) if name in _NAMES and not callable(_NAMES[name]):
            return _NAMES[name]
        case ast.Name(id=name):
            raise ValueError(f"uses the name {name!r}, which means nothing here")
        case ast.Attribute(value=ast.Name(id="math"), attr=name) if name in _CONSTANTS:
            return _CONSTANTS[name]
        case ast.List() | ast.Tuple():
            return [_value(item) for item in node.elts]
        case ast.UnaryOp() if type(node.op) in _UNARY:
            return _UNARY[type(node.op)](_value(node.operand))
        case ast.BinOp() if type(node.op) in _BINARY:
            left, right = _value(node.left), _value(node.right)
            _refuse_large(node.op, left, right)
            return _BINARY[type(node.op)](left, right)
        case ast.BoolOp():
            wanted = isinstance(node.op, ast.Or)
            result: Any = None
            for item in node.values:
                result = _value(item)
                if bool(result) == wanted:
                    break
            return result
        case ast.Compare():
            left = _value(node.left)
            for op, item in zip(node.ops, node.comparators, strict=True):
                if type(op) not in _COMPARE:
                    raise ValueError(f"uses {type(op).__name__}, which is not allowed")
                right = _value(item)
                if not _COMPARE[type(op)](left, right):
                    return False
                left = right
            return True
        case ast.IfExp():
            return _value(node.body) if _value(node.test) else _value(node.orelse)
        case ast.Call(func=func, keywords=[]):
            name = func.attr if isinstance(func, ast.Attribute) else getattr(func, "id", "")
            of_math = not isinstance(func, ast.Attribute) or ast.unparse(func.value) == "math"
            if not of_math or not callable(_NAMES.get(name)):
                raise ValueError(f"calls {ast.unparse(func)}, which is not allowed")
            return _NAMES[name](*[_value(item) for item in node.args])
        case _:
            raise ValueError(f"uses {ast.unparse(node)!r}, which is not allowed")


def _refuse_large(op: ast.operator, left: Any, right: Any) -> None:
    """Keeps an expression from taking all memory or time."""
    if isinstance(op, ast.Pow) and (abs(right) > LARGEST_EXPONENT or abs(left) > 1e6):
        raise ValueError(f"raises {left} to {right}, which is too much")
    if isinstance(op, ast.Mult):
        for sized, count in ((left, right), (right, left)):
            if hasattr(sized, "__len__") and len(sized) * count > LONGEST_RESULT:
                raise ValueError("makes a text that is too long")
    if isinstance(op, ast.Mod) and isinstance(left, str):
        raise ValueError("formats a text, which is not allowed")
