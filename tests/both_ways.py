"""The same call with the compiled part and without it: both must come to the same bits."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np

from imucald.core import compiled

Outcome = tuple[str, Any, Any]


def agree(function: Callable[..., Any], *arguments: Any, errors: str = "raise") -> Any:
    """Call a function both ways, each with arguments of its own; return what it returned.

    errors: what numpy does where no arithmetic bears the numbers.
    """
    with_it = _outcome(function, copy.deepcopy(arguments), errors)
    with compiled.left_out():
        without = _outcome(function, copy.deepcopy(arguments), errors)
    assert with_it[0] == without[0], (with_it, without)
    if with_it[0] == "returned":  # where it raised, nobody uses what it was given
        assert_same(with_it[1], without[1], "result")
        assert_same(with_it[2], without[2], "argument")
    return with_it[1]


def _outcome(function: Callable[..., Any], arguments: tuple[Any, ...], errors: str) -> Outcome:
    try:
        with np.errstate(over=errors, invalid=errors, divide=errors), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return "returned", function(*arguments), arguments
    except Exception as error:
        return f"raised {type(error).__name__}", None, None


def assert_same(one: Any, other: Any, where: str) -> None:
    """The same, to the last bit but for the sign of a zero; NaN is NaN."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        one, other = np.asarray(one), np.asarray(other)
        assert one.shape == other.shape, where
        assert one.dtype == other.dtype, where
        same = np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
        assert same, f"{where}: {one} {other}"
    elif isinstance(one, Mapping):
        assert list(one) == list(other), where
        for key in one:
            assert_same(one[key], other[key], f"{where}[{key!r}]")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), where
        for k, (x, y) in enumerate(zip(one, other, strict=True)):
            assert_same(x, y, f"{where}[{k}]")
    elif isinstance(one, msgspec.Struct):
        for name in one.__struct_fields__:
            assert_same(getattr(one, name), getattr(other, name), f"{where}.{name}")
    elif isinstance(one, float):
        assert one == other or (math.isnan(one) and math.isnan(other)), f"{where}: {one} {other}"
    elif type(one).__eq__ is not object.__eq__ or one is None:
        assert one == other, f"{where}: {one} {other}"
    elif hasattr(one, "__dict__"):
        assert_same(vars(one), vars(other), where)
