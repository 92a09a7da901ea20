"""Floats as integers, and products of sparse matrices of them without any rounding."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[Any]  # object arrays of Python's integers


@dataclass(frozen=True, eq=False)
class Fixed:
    """The numbers `integers` / 2^`bits`."""

    integers: Integers
    bits: int

    def __add__(self, other: Fixed) -> Fixed:
        bits = max(self.bits, other.bits)
        return Fixed(self._at(bits) + other._at(bits), bits)

    def __sub__(self, other: Fixed) -> Fixed:
        bits = max(self.bits, other.bits)
        return Fixed(self._at(bits) - other._at(bits), bits)

    def __getitem__(self, where: Any) -> Fixed:
        return Fixed(self.integers[where], self.bits)

    def _at(self, bits: int) -> Integers:
        return self.integers << (bits - self.bits) if bits > self.bits else self.integers

    def rounded(self, bits: int) -> Fixed:
        """To a multiple of 2^-bits, towards below."""
        return self if bits >= self.bits else Fixed(self.integers >> (self.bits - bits), bits)

    def times_power(self, exponent: int) -> Fixed:
        """Times 2^exponent."""
        return Fixed(self.integers, self.bits - exponent)

    def floats(self) -> NDArray[np.float64]:
        """The nearest doubles."""
        one = 1 << max(self.bits, 0)
        more = 1 << max(-self.bits, 0)
        return np.array([x * more / one for x in self.integers.tolist()], dtype=float)

    def floats_at(self, power: int) -> NDArray[np.float64]:
        """The nearest doubles of 2^power x."""
        return self.times_power(power).floats()

    def fractions(self) -> NDArray[Any]:
        one = Fraction(1, 2**self.bits) if self.bits >= 0 else Fraction(2**-self.bits)
        array = np.empty(len(self.integers), dtype=object)
        array[:] = [x * one for x in self.integers.tolist()]
        return array

    @property
    def exponent(self) -> int:
        """The least e with all |x| < 2^e; very small if all are zero."""
        return max((abs(x).bit_length() for x in self.integers.tolist()), default=0) - self.bits


def fixed(values: Any) -> Fixed:
    """Floats as they stand."""
    flat = np.asarray(values, dtype=float).ravel()
    mantissa, exponent = np.frexp(flat)
    used = exponent[mantissa != 0]
    bits = int(53 - np.min(used)) if used.size else 0
    whole = np.ldexp(mantissa, 53).astype(np.int64).astype(object)
    shifts = np.where(mantissa != 0, exponent - 53 + bits, 0).astype(object)
    return Fixed(whole << shifts if len(flat) else np.zeros(0, dtype=object), bits)


class FixedMatrix:
    """A sparse matrix of floats as they stand."""

    def __init__(self, rows: Any) -> None:
        rows = rows.tocsr()
        self.shape = rows.shape
        self._data, self._columns = fixed(rows.data), rows.indices
        self._filled = np.flatnonzero(np.diff(rows.indptr))
        self._starts = rows.indptr[:-1][self._filled]

    def __matmul__(self, x: Fixed) -> Fixed:
        sums = np.full(self.shape[0], 0, dtype=object)
        if len(self._filled):
            sums[self._filled] = np.add.reduceat(self._data.integers * x.integers[self._columns], self._starts)
        return Fixed(sums, self._data.bits + x.bits)
