"""A readout's equation with its derivatives, from the one place where the equation stands."""

from functools import lru_cache

from lampest.panel.compiled import Compiled
from lampest.panel.network import ReadCircuit

# What the compiled equation returns, each (rows, columns): the reading y = h(p, q, t) of p = Z_jj, q = Z_kk, t = Z_jk,
# its slopes, and its second derivatives, in this order.
PARTS = ("y", "p", "q", "t", "pp", "pq", "pt", "qq", "qt", "tt")


@lru_cache(maxsize=64)
def compiled_equation(readout: ReadCircuit, rows: int, columns: int) -> Compiled:
    """h, ∂h and ∂²h of three flat (rows · columns) inputs, row by row: PARTS one after the other, flat."""
    import casadi

    flat = [casadi.SX.sym(name, rows * columns) for name in ("p", "q", "t")]
    reading = readout.reading(*(casadi.reshape(entry, columns, rows).T for entry in flat))
    value = casadi.vec(casadi.densify(reading).T)
    slopes = [casadi.gradient(casadi.sum1(value), entry) for entry in flat]
    seconds = [
        casadi.gradient(casadi.sum1(slopes[one]), flat[other])
        for one, other in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    ]
    parts = casadi.vertcat(*(casadi.densify(part) for part in (value, *slopes, *seconds)))
    return Compiled(casadi.Function("equation", flat, [parts]))


@lru_cache(maxsize=64)
def reads_own(readout: ReadCircuit, rows: int, columns: int) -> tuple[bool, bool]:
    """Whether the reading asks for the rows' own impedances Z_jj, and for the columns' Z_kk."""
    import casadi

    row, column, mutual = (casadi.SX.sym(name, rows, columns) for name in ("p", "q", "t"))
    reading = readout.reading(row, column, mutual)
    return bool(casadi.depends_on(reading, row)), bool(casadi.depends_on(reading, column))
