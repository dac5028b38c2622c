"""The program of docs/howto/adding/program.md in CasADi's Opti, beside that of lampest.

It has the readings, the walk and the known cell, for equal two-point readings without wire.

Run it with: python -m docs.studies.opti
"""

import time

import casadi
import numpy as np

import lampest
from lampest.cost.problem import Evaluation
from lampest.estimate.own_program import OwnProgram
from lampest.panel.panel import Array


def posed() -> OwnProgram:
    """Return the program as lampest states it."""
    recording = lampest.datasets.load("rod")
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=5.0)]
    first = int(recording.measured_frames()[0])
    program = lampest.program(recording, terms, frames=[first, first + 1])
    now, before = (casadi.log(casadi.vec(program.cells(frame))) for frame in (1, 0))
    program = program.with_cost(casadi.sumsqr((now - before) / 0.01))
    return program.subject_to("known", program.cells(1)[9, 9] / 1000, 3.9)


def optimum_of_opti(evaluations: tuple[Evaluation, ...]) -> tuple[Array, int]:
    """Return ln r of the second frame in kilo-ohm, (rows, columns), and the number of unknowns."""
    opti = casadi.Opti()
    cost = 0
    logs = []
    ones = np.ones((10, 1))
    for evaluation in evaluations:
        data = evaluation.data
        g = opti.variable(10, 10)  # millisiemens
        voltage = opti.variable(19, 19)  # of each line for a current into each; the last at ground
        rows = casadi.horzcat(casadi.diag(casadi.sum2(g)), -g)
        columns = casadi.horzcat(-g.T, casadi.diag(casadi.sum1(g)))
        balance = casadi.vertcat(rows, columns)[:19, :19]
        opti.subject_to(balance @ voltage == np.eye(19))
        opti.subject_to(opti.bounded(1e-3, casadi.vec(g), 10))
        own = casadi.vertcat(casadi.diag(voltage), 0)
        across = casadi.horzcat(voltage[:10, 10:], casadi.MX(10, 1))
        reading = 1000 * (own[:10] @ ones.T + ones @ own[10:].T - 2 * across)
        cost += casadi.sumsqr((reading - data.measured[0]) / data.sigma[0])
        log = -casadi.log(g)
        logs.append(log)
        cost += 5 * casadi.sumsqr(log[1:, :] - log[:-1, :])
        cost += 5 * casadi.sumsqr(log[:, 1:] - log[:, :-1])
        equal = float(1000 / data.uniform_start.mean())
        start = np.kron([[0, -1], [-1, 0]], np.ones((10, 10))) + 10 * np.eye(20)
        opti.set_initial(g, equal)
        opti.set_initial(voltage, np.linalg.inv(equal * start[:19, :19]))
    opti.minimize(cost + casadi.sumsqr((logs[1] - logs[0]) / 0.01))
    opti.subject_to(1 / g[9, 9] == 3.9)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    return np.asarray(opti.solve().value(logs[1])), int(opti.nx)


if __name__ == "__main__":
    begin = time.process_time()
    program = posed()
    solved = program.solve()
    by_program = time.process_time() - begin
    begin = time.process_time()
    log, unknowns = optimum_of_opti(program.evaluations)
    by_opti = time.process_time() - begin
    distance = np.abs(np.log(solved.cell_resistance[1] / 1000) - log).max()
    print(f"both agree in ln r to 1e-7: {distance < 1e-7}")
    print(f"unknowns: {len(solved.result.unknown)} and {unknowns}")
    print(f"processor time: {by_program:.1f} s and {by_opti:.1f} s")
