"""The program of some frames, to which a notebook adds unknowns and constraints.

    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=10.0)]
    program = lampest.program(recording, terms)
    program = program.subject_to("equal", program.cells()[0, 3] - program.cells()[0, 4])
    solved = program.solve()
    solved.cell_resistance, solved.cell_resistance_errors

IPOPT solves it from the uniform start. `own_solution` checks the result outside of IPOPT.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import casadi
import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.cost.terms import Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import named_method
from lampest.estimate.own_solution import OwnSolution
from lampest.estimate.sequence import first_stream
from lampest.files.errors import InputError, in_words
from lampest.formulation.instance import Instance, Multipliers, ProgramResult
from lampest.formulation.ipopt import Interface
from lampest.formulation.patterns import EXCITATIONS
from lampest.formulation.program import Program
from lampest.formulation.scene_numbers import SymbolicReadout
from lampest.inference.prepared import Prepared
from lampest.panel.compiled import SymbolsOwner, guarded
from lampest.recording.recording import UNLOADED, Recording
from lampest.solvers.by_ipopt import interface_to
from lampest.solvers.multistart import evaluated
from lampest.solvers.posed import Bounds
from lampest.solvers.solution import Settings, Status


@dataclass(frozen=True, eq=False)
class OwnProgram(SymbolsOwner):
    """Program of some frames of a recording.

    `with_…` and `subject_to` return a program with one more part.

    Attributes
    ----------
    symbols : Program
        The symbols: cells, voltages, readings, parameters.
    evaluations : tuple of Evaluation
        Costs of the frames at their starts.
    settings : Settings
    formulation : {'nodal', 'per_pixel'}
    unread : mapping of int to Status
        Frames of the program whose readings determine nothing, and why.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> terms = [lampest.Misfit(), lampest.Gradient(weight=1e-3)]
    >>> program = lampest.program(recording, terms, frames=[2, 3])
    >>> program.cells(1).shape
    (2, 3)
    """

    symbols: Program
    evaluations: tuple[Evaluation, ...]
    settings: Settings
    formulation: str = "nodal"
    unread: Mapping[int, Status] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return the program as a table of cost, unknowns and constraints, with their sizes."""
        return f"{self.formulation} {self.symbols!r}"

    def cells(self, frame: int = 0) -> casadi.SX:
        """Return the cells of one frame in ohm, (rows, columns) symbols.

        Raises InputError for a frame that the program does not have.
        """
        return self.symbols.cells(frame)

    @property
    def reading(self) -> casadi.SX:
        """Readings y = h(V) of all frames, (cells, frames) in the readout's unit."""
        return self.symbols.reading

    def with_unknown(self, name: str, **about: Any) -> "tuple[OwnProgram, casadi.SX]":
        """Return the program with a further unknown, and its symbol.

        The arguments are those of `Program.with_unknown`.

        Raises InputError if the name is taken, or a number is out of range.
        """
        symbols, unknown = self.symbols.with_unknown(name, **about)
        return replace(self, symbols=symbols), unknown

    def with_reading(self, changed: Callable[[casadi.SX], Any]) -> "OwnProgram":
        """Return the program whose terms read changed(y).

        Raises InputError if the result has another shape.
        """
        return replace(self, symbols=self.symbols.with_reading(changed))

    def with_cost(self, added: Any) -> "OwnProgram":
        """Return the program with a further cost, one number in the unit of φ.

        Raises InputError for another shape.
        """
        return replace(self, symbols=self.symbols.with_cost(added))

    def subject_to(
        self, name: str, expression: Any, lower: float = 0.0, upper: float | None = None
    ) -> "OwnProgram":
        """Return the program with a constraint lower ≤ expression ≤ upper.

        Without an upper limit the constraint is the equation expression = lower.

        Raises InputError if the name is taken, or the expression is no column, or no function of
        the unknowns.
        """
        return replace(self, symbols=self.symbols.subject_to(name, expression, lower, upper))

    def solve(self, start: OwnSolution | None = None) -> OwnSolution:
        """Solve by IPOPT, and check the result; a failed solve does not raise.

        Where the result is no strict minimum to the digits of double precision, IPOPT goes on to
        those digits, and the better result is kept. Where it is a saddle or a slope without end,
        IPOPT begins again with a small barrier. A frame without readings of which no own part
        speaks has no solution.

        Parameters
        ----------
        start : OwnSolution, optional
            Solution of this program, or of one with as many frames and other parts: cells, own
            unknowns and multipliers begin there. By default cells are equal, and multipliers
            IPOPT's.

        Raises InputError for a start that is no solution, of another panel, or without numbers.
        """
        instance = self._instance(start)
        unsolved = [
            status for frame, status in self.unread.items() if not self.symbols.own_speaks_of(frame)
        ]
        if unsolved:
            return OwnSolution(instance, ProgramResult.none(instance), unsolved[0])
        interface = _interface(self.symbols, self.settings)
        multipliers = None
        if start is not None:
            multipliers = instance.multipliers_from(start.instance, start.result)
        solution = OwnSolution(instance, interface.minimise(instance, multipliers))
        solution = solution.refined(interface)
        if solution.solved or not solution.ended:
            return solution
        # A wide barrier may lead to shorts, of which no reading depends on its cell.
        without = Multipliers.none(instance)
        second = solution.ended_at(interface.minimise(instance, without)).refined(interface)
        return second if second.solved else solution

    def _instance(self, start: OwnSolution | None) -> Instance:
        """Return the program's instance that begins at equal cells, or at a solution."""
        evaluations = self.evaluations
        if start is not None:
            if not isinstance(start, OwnSolution):
                raise InputError(f"start must be a solution of a program, not {in_words(start)}")
            cells = start.instance.cells_of(start.result)
            shape = (len(evaluations), *self.symbols.shape)
            if cells.size != np.prod(shape) or not np.all(np.isfinite(cells)):
                raise InputError(
                    "start must be a solution with numbers, of as many frames and cells"
                )
            frames = cells.reshape(len(evaluations), -1, *self.symbols.shape)
            evaluations = tuple(
                evaluated(each.cost, each.data, frame)
                for each, frame in zip(evaluations, frames, strict=True)
            )
        instance = Instance.of(self.symbols, evaluations)
        return instance if start is None else instance.begun_at(start.instance, start.result)


@guarded
@lru_cache(maxsize=8)
def _interface(program: Program, settings: Settings) -> Interface:
    """Return IPOPT's interface to a program with own parts, which is built once."""
    # IPOPT scales own constraints by their gradients.
    return interface_to(program, settings, nlp_scaling_method="gradient-based")


def program(
    recording: Recording,
    terms: Sequence[Term],
    *,
    frames: Sequence[int] | None = None,
    formulation: str = "nodal",
    bounds: Bounds | None = None,
    solver: Settings | None = None,
    numbers: Mapping[str, float] | None = None,
) -> OwnProgram:
    """Return the program of some frames, to which unknowns and constraints can be added.

    Parameters
    ----------
    recording : Recording
    terms : sequence of Term
        Those that compare frames compare with the mean of the unloaded frames. A weight 'auto' is
        the number that `reconstruct` chooses for the recording.
    frames : sequence of int, optional
        Indices into the recording; by default the first measured frame.
    formulation : {'nodal', 'per_pixel'}
    bounds : Bounds, optional
    solver : Settings, optional
    numbers : mapping of str to float, optional
        Numbers of the scene that are unknown, by their dotted keys, such as 'series_resistance_ohm'
        or 'readout.load_ohm', with the standard deviation of a Gaussian prior about the scene's
        number. A list of numbers is one unknown for each line. All frames share them. Lower bounds
        of the cells, which would follow from the scene's numbers, are then absent by default.

    Raises
    ------
    InputError
        If `terms` is no sequence of terms, a frame does not exist, the formulation has another
        name, the panel consists of modules, or a number is no resistance of the scene's circuit.

    Examples
    --------
    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> terms = [lampest.Misfit(), lampest.Gradient(weight=1e-3)]
    >>> program = lampest.program(recording, terms)
    >>> program.subject_to("equal", program.cells()[0, 0] - program.cells()[1, 2]).solve().solved
    True
    """
    bounds = bounds or (Bounds(lower="none") if numbers else Bounds())
    estimator = _checked_estimator(terms, formulation, bounds, solver or Settings())
    prepared = Prepared.of(recording)
    return _of_frames(prepared, estimator, frames, formulation, numbers)


def _of_frames(
    prepared: Prepared,
    estimator: Estimator,
    frames: Sequence[int] | None,
    formulation: str,
    numbers: Mapping[str, float] | None,
) -> OwnProgram:
    """Return the program of frames by an estimator whose weights may still be chosen."""
    scene = prepared.resolved.scene
    estimator = estimator.for_outliers(scene)
    if scene.panel.modules is not None:
        raise InputError("an own program has one network; take a module: recording.modules[0]")
    readings = prepared.noise.readings
    if estimator.automatic:
        estimator = first_stream(prepared.resolved, readings, estimator, prepared.noise).estimator
    if estimator.automatic:
        raise InputError("weight: auto needs a measured frame from which it is chosen")
    chosen = _chosen_frames(prepared.recording, frames)
    background = Background(scene)
    enough = readings.enough(scene)
    unread = {number: Status.UNREAD for number, frame in enumerate(chosen) if not enough[frame]}
    if unread and enough.any():
        # Cells without readings have bounds and units of the other frames.
        usual = readings[enough].mean()
        known = enough[:, None, None] | (readings.seen > 0)
        value = np.where(known, readings.value, usual.value)
        sigma = readings.sigma
        if sigma is not None:
            sigma = np.where(known, sigma, usual.known_sigma)
        readings = replace(readings, value=value, sigma=sigma)
    if estimator.relative:
        resting = readings[prepared.recording.role == UNLOADED].mean()
        if not resting.enough(scene):
            unread = dict.fromkeys(range(len(chosen)), Status.UNRESTED)
        unloaded = scene.circuit.uniform_start(resting.value)
        background = Background(scene, previous=unloaded, baseline=unloaded)
    cost = estimator.cost(scene, 1, partial=readings.partial)
    data = [estimator.data(readings[frame].alone(), background) for frame in chosen]
    evaluations = tuple(evaluated(cost, each, each.uniform_start) for each in data)
    symbolic = None
    if numbers:
        symbolic = SymbolicReadout.of(scene, numbers, readings[chosen].mean().value)
    symbols = Program.build(cost, scene.circuit, scene.wiring, formulation, len(chosen), symbolic)
    return OwnProgram(symbols, evaluations, estimator.solver, formulation, unread)


def _checked_estimator(
    terms: Sequence[Term], formulation: str, bounds: Bounds, solver: Settings
) -> Estimator:
    """Return the estimator of an own program.

    Raises InputError for another formulation, and for terms that are no sequence.
    """
    if formulation not in EXCITATIONS:
        raise InputError(
            f"formulation must be one of {', '.join(EXCITATIONS)} "
            f"for an own program, not {formulation}"
        )
    if isinstance(terms, str) or not isinstance(terms, Sequence):
        raise InputError(f"terms must be a sequence of terms, not {terms!r}")
    method = named_method(formulation)
    return Estimator(tuple(terms), method, solver=solver, bounds=bounds, error_bars=False)


def _chosen_frames(recording: Recording, frames: Sequence[int] | None) -> list[int]:
    """Return the frames of a program, by default the first measured one.

    Raises InputError if there is none, or one does not exist.
    """
    indices = np.asarray(recording.measured_frames()[:1] if frames is None else frames)
    if frames is None and not len(indices):
        raise InputError("the recording has no measured frame; name frames=[...]")
    if indices.ndim != 1 or not len(indices) or indices.dtype.kind not in "iu":
        raise InputError(
            f"frames must be a list of one or more indices such as [2, 3], not {frames!r}"
        )
    for frame in indices:
        if not 0 <= frame < len(recording.role):
            raise InputError(
                f"the recording has frames 0 to {len(recording.role) - 1}, not {frame}"
            )
    return [*indices.tolist()]
