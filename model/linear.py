"""Small dense linear algebra on symbols: elimination in a given order, matrix exponential."""

from __future__ import annotations

import casadi as ca

SX = ca.SX


class Elimination:
    """LU factors of a symbolic matrix without pivoting, in the given order of unknowns.

    The matrices met here are I/(h gamma) - A with a small h, whose diagonal dominates, so that no
    pivoting is needed; zeros are skipped, so that the generated code is as short as the equations
    are sparse.
    """

    def __init__(self, matrix: SX) -> None:
        self.n = matrix.shape[0]
        self.a = [[matrix[i, j] for j in range(self.n)] for i in range(self.n)]
        for k in range(self.n):
            for i in range(k + 1, self.n):
                if self.a[i][k].is_zero():
                    continue
                self.a[i][k] = self.a[i][k] / self.a[k][k]
                for j in range(k + 1, self.n):
                    if not self.a[k][j].is_zero():
                        self.a[i][j] = self.a[i][j] - self.a[i][k] * self.a[k][j]

    def forward(self, rhs: SX) -> list[SX]:
        """Return L^-1 rhs."""
        y = [rhs[i] for i in range(self.n)]
        for i in range(self.n):
            for k in range(i):
                if not self.a[i][k].is_zero():
                    y[i] = y[i] - self.a[i][k] * y[k]
        return y

    def backward(self, y: list[SX], last: SX | None = None) -> SX:
        """Return U^-1 y; `last`, where given, is the last unknown and not solved for."""
        x = list(y)
        for i in reversed(range(self.n)):
            if i == self.n - 1 and last is not None:
                x[i] = last
                continue
            for k in range(i + 1, self.n):
                if not self.a[i][k].is_zero():
                    x[i] = x[i] - self.a[i][k] * x[k]
            x[i] = x[i] / self.a[i][i]
        return ca.vertcat(*x)

    def solve(self, rhs: SX) -> SX:
        """Return the solution for one right-hand side."""
        return self.backward(self.forward(rhs))


def expm(matrix: SX, squarings: int = 12, order: int = 8) -> SX:
    """Return the exponential of a small symbolic matrix by a scaled Taylor series.

    Accurate to rounding for norms up to about 2**squarings / 8.
    Source: moler2003 methods 1 and 3.
    """
    n = matrix.shape[0]
    scaled = matrix / 2.0**squarings
    term, total = SX.eye(n), SX.eye(n)
    for k in range(1, order + 1):
        term = term @ scaled / k
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return total
