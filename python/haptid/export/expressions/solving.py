"""Small linear systems as expressions: LDL' and QR factorisations without square roots, mobility matrix, force."""

from __future__ import annotations

from haptid._internal.late import dataclass
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import cross, dot, vector

# Pivots below this share of their original diagonal entry count as singular.
_SINGULAR = 1e-7


@dataclass(frozen=True)
class Factors:
    """M = L D L', of a symmetric positive definite matrix.

    Attributes:
        lower: rows of L below its unit diagonal.
        checks: all positive where the matrix is positive definite and not nearly singular.
        inverse: 1 / D.
    """

    lower: list[list[Expr]]
    checks: list[Expr]
    inverse: list[Expr]

    @staticmethod
    def of(M: list[list[Expr]]) -> Factors:
        """Row by row (Golub and Van Loan 2013, section 4.1.2).

        Raises:
            ZeroDivisionError: the matrix is identically singular.
        """
        n = len(M)
        lower: list[list[Expr]] = [[] for _ in range(n)]
        scaled: list[list[Expr]] = [[] for _ in range(n)]
        checks: list[Expr] = []
        inverse: list[Expr] = []
        for i in range(n):
            for j in range(i):
                entry = M[i][j]
                for k in range(j):
                    entry = entry - lower[j][k] * scaled[i][k]
                scaled[i].append(entry)
                lower[i].append(entry * inverse[j])
            pivot = M[i][i]
            for k in range(i):
                pivot = pivot - lower[i][k] * scaled[i][k]
            checks.append(pivot - _SINGULAR * M[i][i])
            inverse.append(1.0 / pivot)
        return Factors(lower, checks, inverse)

    def forward(self, b: list[Expr]) -> list[Expr]:
        """L^-1 b."""
        y: list[Expr] = []
        for row, value in zip(self.lower, b, strict=True):
            for factor, known in zip(row, y, strict=True):
                value = value - factor * known
            y.append(value)
        return y

    def solve(self, b: list[Expr]) -> list[Expr]:
        """M^-1 b."""
        y = [value * inverse for value, inverse in zip(self.forward(b), self.inverse, strict=True)]
        for i in reversed(range(len(y))):
            for k in range(i + 1, len(y)):
                y[i] = y[i] - self.lower[k][i] * y[k]
        return y


# Least length of a column of Q, squared, relative to that of A: where Python counts a pose of loops as singular.
_DEPENDENT = 1e-6


@dataclass(frozen=True)
class Orthogonal:
    """A P = Q R of a matrix with independent columns; R has a unit diagonal, the columns of Q are orthogonal.

    Modified Gram-Schmidt, which needs no exchange of rows (Golub and Van Loan 2013, section 5.2.8): there are no
    branches, and rows that repeat what others say are allowed. Columns with many zeros come first: they stay sparse.

    Attributes:
        order: columns of A in the order of P.
        columns: of Q.
        upper: columns of R above its diagonal.
        inverse: 1 / |q|^2 of every column.
        checks: all positive where no column nearly depends on those before it.
    """

    order: list[int]
    columns: list[list[Expr]]
    upper: list[list[Expr]]
    inverse: list[Expr]
    checks: list[Expr]

    @staticmethod
    def of(A: list[list[Expr]]) -> Orthogonal:
        """Of the rows of a matrix.

        Raises:
            ZeroDivisionError: a column is identically zero.
        """
        by_column = [list(column) for column in zip(*A, strict=True)]
        filled = [sum(entry.value != 0 for entry in column) for column in by_column]
        order = sorted(range(len(filled)), key=lambda k: (filled[k], k))
        made = Orthogonal(order, [], [], [], [])
        for a in (by_column[k] for k in order):
            shares, q = made._taken_out(a)
            square = dot(q, q)
            made.upper.append(shares)
            made.columns.append(q)
            made.inverse.append(1.0 / square)
            made.checks.append(square - _DEPENDENT * dot(a, a))
        return made

    def solve(self, b: list[Expr]) -> list[Expr]:
        """x of A x = b, least squares."""
        x, _ = self._taken_out(b)
        for i in reversed(range(len(x))):
            for k in range(i + 1, len(x)):
                x[i] = x[i] - self.upper[k][i] * x[k]
        return [x[self.order.index(k)] for k in range(len(x))]

    def transposed(self, f: list[Expr]) -> list[Expr]:
        """y of A' y = f of least length."""
        w: list[Expr] = []
        for shares, value in zip(self.upper, (f[k] for k in self.order), strict=True):
            for share, known in zip(shares, w, strict=True):
                value = value - share * known
            w.append(value)
        scaled = [value * inverse for value, inverse in zip(w, self.inverse, strict=True)]
        return [dot(row, scaled) for row in zip(*self.columns, strict=True)]

    def _taken_out(self, b: list[Expr]) -> tuple[list[Expr], list[Expr]]:
        """Coordinates of a vector along the columns of Q, and what is left of it."""
        shares, rest = [], b
        for q, inverse in zip(self.columns, self.inverse, strict=True):
            share = dot(q, rest) * inverse
            rest = [x - share * y for x, y in zip(rest, q, strict=True)]
            shares.append(share)
        return shares, rest


def mobility(factors: Factors, J: list[list[Expr]]) -> list[list[Expr]]:
    """J M^-1 J', symmetric, by J L^-T = (L^-1 J')'."""
    half = [factors.forward(row) for row in J]
    scaled = [[value * inverse for value, inverse in zip(row, factors.inverse, strict=True)] for row in half]
    rows = len(J)
    made = [[half[0][0]] * rows for _ in range(rows)]
    for a in range(rows):
        for b in range(a + 1):
            made[a][b] = made[b][a] = dot(scaled[a], half[b])
    return made


def force(J: list[list[Expr]], torque: list[Expr]) -> tuple[list[Expr], list[Expr]]:
    """Least-squares or minimum-norm solution of J' f = torque, and the expressions that must be positive.

    With three coordinates by Cramer's rule; with more by least squares; with fewer, the force in the directions in
    which the handle can move.

    Args:
        J: linear rows of the Jacobian, (3, active).
        torque: on the coordinates, (active).

    Raises:
        ZeroDivisionError: J is singular in every pose.
    """
    n = len(torque)
    if n == 3:
        a, b, c = (vector([row[k] for row in J]) for k in range(3))
        areas = (cross(b, c), cross(c, a), cross(a, b))
        volume = dot(a, areas[0])
        inverse = 1.0 / volume
        scaled = [value * inverse for value in torque]
        check = volume * volume - _SINGULAR * (dot(a, a) * dot(b, b) * dot(c, c))
        return [dot([area[k] for area in areas], scaled) for k in range(3)], [check]
    if n > 3:
        factors = Factors.of([[dot(J[a], J[b]) for b in range(3)] for a in range(3)])
        return factors.solve([dot(row, torque) for row in J]), factors.checks
    columns = [[row[k] for row in J] for k in range(n)]
    factors = Factors.of([[dot(columns[a], columns[b]) for b in range(n)] for a in range(n)])
    weights = factors.solve(torque)
    return [dot(row, weights) for row in J], factors.checks
