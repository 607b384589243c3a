"""The shapes that lines of a log have had so far, held against a block of lines at a time.

A shape is learned from one line that the strict reader accepted; the lines of a block that have it
are then found together.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Final, Generic, Protocol, TypeVar

import numpy as np

from imucald.can.logs.ascii_columns import Index

MAX_SHAPES: Final = 32
"""Shapes kept; more would cost time on every line that has none of them."""
NEW_SHAPES: Final = 16
"""Shapes learned in one block; beyond, lines are read one by one."""


class LineShape(Protocol):
    """What lines have in common."""

    @property
    def key(self) -> Hashable:
        """What distinguishes it from other shapes."""
        ...


S = TypeVar("S", bound=LineShape)
F = TypeVar("F")


class KnownShapes(Generic[S, F]):
    """Shapes S, the commonest of the last block first: each costs only the lines that follow.

    learn: makes the shape of a line; None where the line is not to be read by its shape.
    """

    def __init__(self, learn: Callable[[bytes], S | None]) -> None:
        self._learn = learn
        self._shapes: list[S] = []

    def find(
        self,
        count: int,
        text: Callable[[int], bytes],
        find: Callable[[S, Index], tuple[Index, list[F]]],
    ) -> tuple[Index, list[F]]:
        """Hold every known shape against the lines, then learn new ones from what is left.

        count: lines of the block; text: gives one of them. find: takes a shape and lines; gives
        those of them that have another shape, and what was found (F) in the others.
        Returns the lines that have none of the shapes, and what was found.
        """
        left: Index = np.arange(count)
        others: list[Index] = []
        found: list[F] = []
        ranked: list[tuple[int, S]] = []

        def take(shape: S) -> None:
            nonlocal left
            before = len(left)
            if before:
                left, part = find(shape, left)
                found.extend(part)
            ranked.append((before - len(left), shape))

        for shape in self._shapes:
            take(shape)
        new = 0
        while len(left) and new < NEW_SHAPES:
            first = left[0]
            learned = self._new_shape(text(first))
            if learned is not None:
                new += 1
                take(learned)
            if len(left) and left[0] == first:
                others.append(left[:1])
                left = left[1:]
        ranked.sort(key=lambda one: -one[0])
        self._shapes = [shape for _, shape in ranked[:MAX_SHAPES]]
        return np.concatenate([*others, left]), found

    def _new_shape(self, line: bytes) -> S | None:
        """The shape of a line, unless it is known."""
        shape = self._learn(line)
        if shape is None or any(known.key == shape.key for known in self._shapes):
            return None
        self._shapes.append(shape)
        return shape
