"""Least squares in information form, shared by the least-squares methods: the matrix as states, and
its factors.

The information of a row h is h h'; sums of it can neither lose their sign nor, with a prior, wind
up, whatever the input. Source: ljung1999 section 11.2.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, State
from bristle.observer.method import stack_symmetric, symmetric_states, unstack_symmetric

SX = ca.SX
# share of each diagonal entry that keeps the elimination from dividing by zero
SINGULAR_BELOW = 1e-12
ZERO_ENTRY = 1e-150  # entries up to this size count as zero


def states(order: int, name: str = "information") -> tuple[State, ...]:
    """Declare a symmetric matrix, of which the lower triangle is kept."""
    return symmetric_states(name, "1", "information matrix", order)


def read(p: Namespace, order: int, name: str = "information") -> SX:
    """Return the matrix."""
    return stack_symmetric(p, name, order)


def write(matrix: SX, name: str = "information") -> dict[str, SX]:
    """Return the next states."""
    return unstack_symmetric(name, matrix)


class Factors:
    """L D L' of a symmetric matrix without pivoting, each diagonal entry raised by a tiny share of
    itself.

    Where a column is a combination of others, an entry of D would be zero or, by rounding,
    negative; it stays positive. `shares` tell of each variable how much of it the ones before it do
    not explain; 0 where there is nothing of it.
    """

    def __init__(self, matrix: SX) -> None:
        self.n = n = matrix.shape[0]
        self.l = [[SX(0)] * n for _ in range(n)]
        self.d, self.shares = [SX(0)] * n, [SX(0)] * n
        for j in range(n):
            scaled = [self.l[j][k] * self.d[k] for k in range(j)]
            own = matrix[j, j] * (1 + SINGULAR_BELOW) + ZERO_ENTRY
            self.d[j] = own - sum(self.l[j][k] * scaled[k] for k in range(j))
            self.shares[j] = ca.if_else(matrix[j, j] > ZERO_ENTRY, self.d[j] / own, 0)
            for i in range(j + 1, n):
                self.l[i][j] = (
                    matrix[i, j] - sum(self.l[i][k] * scaled[k] for k in range(j))
                ) / self.d[j]

    def solve(self, rhs: SX) -> SX:
        """Return the solution for one right-hand side."""
        x: list[SX] = []
        for i in range(self.n):
            x.append(rhs[i] - sum(self.l[i][k] * x[k] for k in range(i)))
        x = [x[i] / self.d[i] for i in range(self.n)]
        for i in reversed(range(self.n)):
            x[i] = x[i] - sum(self.l[k][i] * x[k] for k in range(i + 1, self.n))
        return ca.vertcat(*x)

    def regression(self, count: int | None = None) -> SX:
        """Return the coefficients that explain the last variable by the first `count`, or by all
        others.

        Of the last variable, all others leave `d[-1]` unexplained.
        """
        last = self.n - 1
        count = last if count is None else count
        x = [self.l[last][i] for i in range(count)]
        for i in reversed(range(count)):
            x[i] = x[i] - sum(self.l[k][i] * x[k] for k in range(i + 1, count))
        return ca.vertcat(*x)

    def inverse_along(self, direction: SX) -> SX:
        """Return a' R^-1 a for the vector a of the first variables, R being the matrix of these."""
        forward: list[SX] = []
        for i in range(direction.numel()):
            forward.append(direction[i] - sum(self.l[i][k] * forward[k] for k in range(i)))
        return SX(sum(x**2 / self.d[i] for i, x in enumerate(forward)))

    def inverse_diagonal(self, count: int | None = None) -> SX:
        """Return the diagonal of the inverse (L^-1)' D^-1 L^-1, of the whole matrix or of that of
        the first `count`.
        """
        n, total = self.n if count is None else count, []
        for i in range(n):
            column = [SX(0)] * i + [SX(1)]
            for j in range(i + 1, n):
                column.append(SX(-sum(self.l[j][k] * column[k] for k in range(i, j))))
            total.append(sum(column[j] ** 2 / self.d[j] for j in range(i, n)))
        return ca.vertcat(*total)
