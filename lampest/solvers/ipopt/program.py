"""A cost in a formulation as a nonlinear program with exact, sparse derivatives.

Unknowns are conductances s/r (s: geometric mean of the measured resistances), potentials in units of s, and parts
p, q ≥ 0 of every residual whose loss is not smooth (`Loss.lowered`). The cost is divided by its size.
"""

from dataclasses import dataclass

import casadi

from lampest.cost.cost import Cost, Symbols, lowered, program_groups, summands
from lampest.panel.readouts import Readout
from lampest.solvers.ipopt.formulations import Formulation


@dataclass(frozen=True, eq=False)
class Program:
    """Symbols of the nonlinear program with x = (conductance, potentials, split), g = (balance, split_balance) = 0.

    Attributes
    ----------
    split : casadi.SX
        Parts p and q of the residuals that enter through duals, then of the other split residuals, in units of
        `split_scale`.
    split_balance : casadi.SX
        Equations of the residuals that enter through duals; their multipliers are the last ones.
    parameters : mapping
        Name → symbol: the fields of `Given`, `ties` (lines, frames) in 1/s, `weights` of the terms, `scale` s in ohm,
        `cost_scale` (size of the cost) and `split_scale` (size of the split residuals).
    """

    conductance: casadi.SX
    potentials: casadi.SX
    split: casadi.SX
    balance: casadi.SX
    split_balance: casadi.SX
    objective: casadi.SX
    parameters: dict[str, casadi.SX]

    @property
    def unknown(self) -> casadi.SX:
        """Unknowns x as one column."""
        return casadi.vertcat(self.conductance, self.potentials, self.split)

    @property
    def parameter(self) -> casadi.SX:
        """All parameters as one column."""
        return casadi.vertcat(*(casadi.vec(symbol) for symbol in self.parameters.values()))

    @property
    def nlp(self) -> dict[str, casadi.SX]:
        """The program in the form of CasADi's solvers."""
        constraints = casadi.vertcat(self.balance, self.split_balance)
        return {"x": self.unknown, "p": self.parameter, "f": self.objective, "g": constraints}

    @classmethod
    def build(cls, cost: Cost, readout: Readout, formulation: Formulation) -> "Program":
        """Build the program of a cost, a readout and a formulation from symbolic matrices."""
        # Unknown conductances, parameters, and one network for each frame.
        given = cost.symbols().given
        rows, columns = cost.panel.shape
        tie = casadi.SX.sym("tie", rows + columns, cost.frames)
        scale, cost_scale, split_scale = (casadi.SX.sym(name) for name in ("scale", "cost_scale", "split_scale"))
        conductance = casadi.SX.sym("conductance", cost.panel.crossings, cost.frames)
        frames = [casadi.reshape(conductance[:, frame], columns, rows).T for frame in range(cost.frames)]
        networks = [
            formulation.network(readout, cells, tie[:, frame], scale, f"frame{frame}_")
            for frame, cells in enumerate(frames)
        ]
        reading = casadi.horzcat(*(network.reading for network in networks))
        # Objective: losses of the residuals, with non-smooth ones lowered to p, q ≥ 0 and equations.
        pairs = cost.residuals(Symbols(scale / conductance, reading, given))
        weights = casadi.SX.sym("weights", len(cost.terms))
        parts = [lowered(group, split_scale) for group in program_groups(summands(cost.terms, pairs, weights))]
        objective = sum((part.objective for part in parts), casadi.SX(0))
        nothing = casadi.SX(0, 1)
        own = {"ties": tie, "weights": weights, "scale": scale, "cost_scale": cost_scale, "split_scale": split_scale}
        return cls(
            casadi.vec(conductance),
            casadi.vertcat(*(network.potentials for network in networks)),
            casadi.vertcat(nothing, *(side for part in parts for side in part.split)),
            casadi.vertcat(*(network.balance for network in networks)),
            casadi.vertcat(nothing, *(part.equation for part in parts if part.equation is not None)),
            objective / cost_scale,
            dict(given.named()) | own,
        )

    def slope(self) -> casadi.Function:
        """Return the function (x, p) → ∂f/∂(potentials), dense."""
        slope = casadi.densify(casadi.gradient(self.objective, self.potentials))
        return casadi.Function("slope", [self.unknown, self.parameter], [slope], ["x", "p"], ["slope"])

    def hessian(self) -> casadi.Function:
        """Return the function (x, p, σ, λ) → ∇²(σf + λᵀg), upper triangle, (x, x) sparse.

        The current balance is bilinear: its second derivatives are one block between conductances and potentials.
        """
        weight = casadi.SX.sym("weight")
        network_multiplier = casadi.SX.sym("network_multiplier", self.balance.shape[0])
        split_multiplier = casadi.SX.sym("split_multiplier", self.split_balance.shape[0])
        lagrangian = weight * self.objective + casadi.dot(split_multiplier, self.split_balance)
        full = casadi.jacobian(casadi.gradient(lagrangian, self.unknown), self.unknown, {"symmetric": True})
        slope = casadi.gradient(casadi.dot(network_multiplier, self.balance), self.potentials)
        block = casadi.jacobian(slope, self.conductance)
        potentials, conductances = block.shape
        upper = casadi.SX(*full.shape)
        upper[:conductances, conductances : conductances + potentials] = block.T
        arguments = [self.unknown, self.parameter, weight, casadi.vertcat(network_multiplier, split_multiplier)]
        names = ["x", "p", "lam_f", "lam_g"]
        return casadi.Function("nlp_hess_l", arguments, [casadi.triu(full) + upper], names, ["hess_gamma_x_x"])
