"""IPOPT: the program's derivatives, the options, and a solve from a cold or a warm start.

A cold start has a barrier parameter of its own choice, which leads the iterates away from the
bounds and into low minima. A warm start has IPOPT's own multipliers of an earlier solve, and a
small barrier parameter. A fine solve goes on from the end of another one to the digits that double
precision holds.
Source: Wächter & Biegler, Mathematical Programming 106, 2006.
"""

from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from io import StringIO
from typing import Any

import casadi
import numpy as np

from lampest.formulation.instance import Instance, Multipliers, ProgramResult
from lampest.formulation.program import Program
from lampest.panel.compiled import CasadiOwner, guarded

# Distance that IPOPT keeps from a bound, relative to max(bound, 1); far below the accuracy of a
# cell.
PUSH = 1e-9
# MUMPS orders by METIS (5), up to MAX_AMD_UNKNOWNS by AMD (0), and permutes nothing for scaling (0)
# (docs/studies/speed.md). A relaxed bound of 0 would let conductances come back negative.
MAX_AMD_UNKNOWNS = 300
COMMON = {
    "mumps_permuting_scaling": 0,
    "bound_relax_factor": 0.0,
    "nlp_scaling_method": "none",
    "print_level": 0,
    "sb": "yes",
}
QUIET = {"print_time": False, "show_eval_warnings": False}
COLD = {"mu_strategy": "adaptive"}
# The barriers of all cells together stay below a hundredth of the unit of the objective. Otherwise
# they outweigh the cost of a start near the readings, and the iterates leave it for the middle
# between the bounds.
MAX_BARRIER = 0.01
GIVEN_MULTIPLIERS = {"warm_start_init_point": "yes", "mu_strategy": "adaptive"}
WARM = {
    **GIVEN_MULTIPLIERS,
    "warm_start_bound_push": PUSH,
    "warm_start_bound_frac": PUSH,
    "warm_start_slack_bound_push": PUSH,
    "warm_start_slack_bound_frac": PUSH,
    "warm_start_mult_bound_push": PUSH,
    "mu_init": 1e-8,
    "mu_max": 1e-8,
}
# A warm solve ends where the slopes are below a hundred tolerances, at bounds that are met to one:
# by then Newton's steps are quadratic, and the next one moves cells by some 1e-9.
WARM_SLOPES = 100.0
# Readings of shorts are decades below the others, and so are their parts of the optimality
# conditions: IPOPT goes on below its usual tolerance, with pivots that keep digits.
FINE = {
    **GIVEN_MULTIPLIERS,
    "tol": 1e-20,
    "warm_start_bound_push": 1e-20,
    "warm_start_bound_frac": 1e-20,
    "warm_start_slack_bound_push": 1e-20,
    "warm_start_slack_bound_frac": 1e-20,
    "warm_start_mult_bound_push": 1e-30,
    "mu_init": 1e-16,
    "mumps_pivtol": 0.1,
    "mumps_pivtolmax": 0.5,
    "mumps_pivot_order": 5,
    "mumps_permuting_scaling": 7,
}
FINE_ITERATIONS = 60
INTERRUPTED = "NonIpopt_Exception_Thrown"


@dataclass(frozen=True, eq=False)
class Interface(CasadiOwner):
    """IPOPT's interface to one program; derivatives are built once, for cold and for warm starts.

    Attributes
    ----------
    program : Program
    tolerance : float
        Limit of the scaled optimality error.
    max_iterations : int
    own : mapping of str to value
        Further options of IPOPT, which take the place of all others but those of a fine solve. That
        ends where it comes no closer than the usual tolerance.
    """

    program: Program
    tolerance: float
    max_iterations: int
    own: Mapping[str, Any]

    @guarded
    def minimise(
        self, instance: Instance, multipliers: Multipliers | None = None, *, fine: bool = False
    ) -> ProgramResult:
        """Return IPOPT's result for an instance of the program.

        A warm start has multipliers; a `fine` one goes on to the digits that double precision
        holds.

        Raises
        ------
        KeyboardInterrupt
            Ctrl-C came during the solve: CasADi catches it, and ends IPOPT with a status of its own
            or an error that quotes it.
        """
        solver = self.cold
        given = {"x0": instance.start, "p": instance.parameter}
        given |= {"lbx": instance.lower, "ubx": instance.upper}
        given |= {"lbg": instance.equations[0], "ubg": instance.equations[1]}
        if multipliers is not None:
            solver = self._fine if fine else self._warm
            own = multipliers.in_units_of(instance)
            given |= {"lam_x0": own.of_bounds, "lam_g0": own.of_equations}
        try:
            result = solver(**given)
        except RuntimeError as error:
            if KeyboardInterrupt.__name__ in str(error):
                raise KeyboardInterrupt from None
            raise
        stats = solver.stats()
        if stats["return_status"] == INTERRUPTED:
            raise KeyboardInterrupt
        # Where IPOPT gives up before its first iteration, there is no history.
        history = stats.get("iterations", {})
        unknown, of_bounds, of_equations = (
            np.asarray(result[name]).ravel() for name in ("x", "lam_x", "lam_g")
        )
        return ProgramResult(
            unknown,
            of_bounds,
            of_equations,
            status=str(stats["return_status"]),
            iterations=int(stats["iter_count"]) if history else 0,
            corrected=any(history.get("regularization_size", ())),
            history=history,
        )

    def _solver(self, **chosen: Any) -> casadi.Function:
        """Return IPOPT for the program, with chosen options in place of the common ones."""
        order = 0 if self.program.unknown.column.shape[0] <= MAX_AMD_UNKNOWNS else 5
        ipopt = {**COMMON, "mumps_pivot_order": order, **chosen}
        options: dict[str, Any] = {"ipopt": ipopt, **QUIET, **self.program.derivatives}
        return casadi.nlpsol("ipopt", "ipopt", self.program.nlp, options)

    @property
    def _limits(self) -> dict[str, Any]:
        """Limits and further options, which take the place of others."""
        return {"tol": self.tolerance, "max_iter": self.max_iterations, **self.own}

    @cached_property
    def cold(self) -> casadi.Function:
        """IPOPT from a cold start."""
        barrier = {"mu_max": MAX_BARRIER / self.program.conductance.numel()}
        return self._solver(**COLD | barrier | self._limits)

    @cached_property
    def _warm(self) -> casadi.Function:
        """IPOPT for starts with multipliers."""
        nearly = {
            "acceptable_tol": WARM_SLOPES * self.tolerance,
            "acceptable_compl_inf_tol": self.tolerance,
            "acceptable_iter": 1,
        }
        return self._solver(**WARM | nearly | self._limits)

    @cached_property
    def _fine(self) -> casadi.Function:
        """IPOPT for starts with multipliers, to the digits that double precision holds."""
        most = min(FINE_ITERATIONS, self.max_iterations)
        ends = {"acceptable_tol": self.tolerance, "max_iter": most}
        return self._solver(**self._limits | FINE | ends)


def is_option(name: str) -> bool:
    """Return whether IPOPT has an option of this name."""
    return "No such IPOPT option" not in _objection(name, 0)[0]


def check_options(options: Mapping[str, Any]) -> None:
    """Raise ValueError for options that IPOPT does not have, and values that it does not take."""
    for name, value in options.items():
        objection, said = _objection(name, value)
        if objection and not is_option(name):
            raise ValueError(f"IPOPT has no option {name}")
        if objection:
            # IPOPT's own text: the value, and after the option's description what it may be.
            allowed = " ".join(said.partition("Description: ")[2].split())
            raise ValueError(f"IPOPT does not take {name}: {value!r}. {allowed}".strip())


@guarded
def _objection(name: str, value: Any) -> tuple[str, str]:
    """Return CasADi's objection to an option of IPOPT, '' for none, and what IPOPT prints."""
    unknown = casadi.SX.sym("x")
    said = StringIO()
    problem = {"x": unknown, "f": unknown**2}
    try:
        with redirect_stdout(said):
            casadi.nlpsol("options", "ipopt", problem, {"ipopt": {name: value}})
    except (RuntimeError, NotImplementedError) as error:
        return str(error), said.getvalue()
    return "", ""
