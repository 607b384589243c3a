"""Raw expressions: values and conditions from a frame's bytes, without a database.

An OBD-II answer to service 01 PID 0x0D is ``when: "data[1] == 0x41 and data[2] == 0x0D"`` and
``value: "data[3]"``. The language is Python's arithmetic and comparison on ``data[i]`` (one byte),
``length`` and integers. Nothing else is allowed. The same code evaluates an expression for one
frame with Python integers and for columns with int64. The results are equal.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.resolved_signal import EXACT_IN_DOUBLE
from imucald.core.errors import ConfigError

MAX_TEXT = 300
"""Longest accepted expression [characters]. A formula that uses eight bytes is much shorter."""
MAX_BYTE = 63
"""Highest byte index of a CAN FD frame."""
MAX_SHIFT = 40
"""Largest shift [bit]: five bytes, enough for the widest raw field in practice."""

_BINARY = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.LShift, ast.RShift, ast.BitAnd, ast.BitOr)
_COMPARE = (ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE)


class Expression:
    """A compiled raw expression.

    `needs`: number of data bytes that a frame must have. Raises ConfigError with the reason if the
    text is not in the language of this module.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        if len(text) > MAX_TEXT:
            raise ConfigError(f"expression longer than {MAX_TEXT} characters")
        try:
            tree = ast.parse(text.strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise ConfigError(f"the expression {text!r} cannot be read: {error}") from None
        self.needs = 0
        self._check(tree.body)
        self._value = _compiled(_TruthAsNumbers().visit(tree.body), "data", "length")

    def _check(self, node: ast.expr) -> float:
        """Refuse nodes outside the language. Return an upper bound of the value's magnitude."""
        bound = self._bound(node)
        if bound > EXACT_IN_DOUBLE:
            raise ConfigError(
                f"{ast.unparse(node)!r} can exceed 2^53, where numbers are no longer exact"
            )
        return bound

    def _bound(self, node: ast.expr) -> float:
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return abs(float(number))
            case ast.Name(id="length"):
                return MAX_BYTE + 1.0
            case ast.Subscript(value=ast.Name(id="data"), slice=ast.Constant(value=int() as i)):
                if isinstance(i, bool) or not 0 <= i <= MAX_BYTE:
                    raise ConfigError(f"data[{i}] is not a byte of a CAN frame (0..{MAX_BYTE})")
                self.needs = max(self.needs, i + 1)
                return 255.0
            case ast.BinOp(left=left, op=op, right=right) if isinstance(op, _BINARY):
                return self._bound_binary(op, left, right)
            case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
                return max(self._check(operand), 1.0)
            case ast.BoolOp(values=values):
                return max(self._check(value) for value in values)
            case ast.Compare(left=left, ops=[op], comparators=[right]) if isinstance(op, _COMPARE):
                self._check(left)
                self._check(right)
                return 1.0
        raise ConfigError(
            f"{ast.unparse(node)!r} is not allowed in the expression {self.text!r}: use data[i],"
            " length, numbers, + - * / << >> & |, comparisons, and, or, not"
        )

    def _bound_binary(self, op: ast.operator, left: ast.expr, right: ast.expr) -> float:
        if isinstance(op, ast.LShift | ast.RShift):
            self._check_shift(right)
        if isinstance(op, ast.Div):
            self._check_divisor(right)
        if isinstance(op, ast.BitAnd | ast.BitOr | ast.LShift | ast.RShift):
            self._check_whole(left)
            self._check_whole(right)
        a, b = self._check(left), self._check(right)
        match op:
            case ast.Mult():
                return a * b
            case ast.Div():
                return a / b
            case ast.LShift():
                return math.ldexp(a, int(b))
            case ast.RShift():
                return a
        return a + b

    def _check_whole(self, node: ast.expr) -> None:
        for part in ast.walk(node):
            fraction = isinstance(part, ast.Constant) and not isinstance(part.value, int)
            if fraction or isinstance(part, ast.Div | ast.Compare | ast.BoolOp | ast.Not):
                raise ConfigError(f"bit operations in {self.text!r} need an integer on both sides")

    def _check_shift(self, right: ast.expr) -> None:
        if not (
            isinstance(right, ast.Constant)
            and isinstance(right.value, int)
            and 0 <= right.value <= MAX_SHIFT
        ):
            raise ConfigError(f"a shift in {self.text!r} must be a number from 0 to {MAX_SHIFT}")

    def _check_divisor(self, right: ast.expr) -> None:
        if not (isinstance(right, ast.Constant) and right.value):
            raise ConfigError(f"a divisor in {self.text!r} must be a number other than zero")

    def number(self, data: Sequence[int]) -> float:
        """Evaluate the expression for one frame. The caller must check `needs` first."""
        return float(self._value(data, len(data)))

    def holds(self, data: Sequence[int]) -> bool:
        """Evaluate the condition for one frame. The caller must check `needs` first."""
        return bool(self._value(data, len(data)))

    def numbers(self, data: NDArray[np.uint8], length: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Evaluate the expression for N frames: bytes (N, W), lengths (N,)."""
        return np.broadcast_to(self._on_columns(data, length), (len(data),)).astype(np.float64)

    def hold(self, data: NDArray[np.uint8], length: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Evaluate the condition for N frames: bytes (N, W), lengths (N,)."""
        return np.broadcast_to(self._on_columns(data, length), (len(data),)).astype(np.bool_)

    def _on_columns(self, data: NDArray[np.uint8], length: NDArray[np.uint8]) -> Any:
        return self._value(_ByteColumns(data), length.astype(np.int64))


class _ByteColumns:
    def __init__(self, data: NDArray[np.uint8]) -> None:
        self._data = data

    def __getitem__(self, i: int) -> NDArray[np.int64]:
        if i >= self._data.shape[1]:
            return np.zeros(len(self._data), dtype=np.int64)
        return self._data[:, i].astype(np.int64)


class _TruthAsNumbers(ast.NodeTransformer):
    """Make comparisons, ``and``, ``or`` and ``not`` the numbers 0 and 1, in the same way for
    integers and arrays."""

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        return ast.BinOp(node, ast.Mult(), ast.Constant(1))

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        self.generic_visit(node)
        bits = ast.BitAnd() if isinstance(node.op, ast.And) else ast.BitOr()
        terms = [_compared(value, ast.NotEq()) for value in node.values]
        return reduce(lambda one, other: ast.BinOp(one, bits, other), terms)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        self.generic_visit(node)
        return _compared(node.operand, ast.Eq()) if isinstance(node.op, ast.Not) else node


def _compared(value: ast.expr, how: ast.cmpop) -> ast.expr:
    """Return the comparison of a value with 0, as the number 0 or 1."""
    return ast.BinOp(ast.Compare(value, [how], [ast.Constant(0)]), ast.Mult(), ast.Constant(1))


def _compiled(tree: ast.expr, *names: str) -> Callable[..., Any]:
    arguments = ast.arguments(
        posonlyargs=[], args=[ast.arg(n) for n in names], kwonlyargs=[], kw_defaults=[], defaults=[]
    )
    function = ast.Expression(ast.Lambda(arguments, tree))
    ast.fix_missing_locations(function)
    code = compile(function, "<expression>", "eval")
    result: Callable[..., Any] = eval(code, {"__builtins__": {}})
    return result
