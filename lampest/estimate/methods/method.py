"""Methods of estimation: from a frame's data to verified cells and the state for the next frame."""

from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Term
from lampest.estimate.state import AnyState, SequenceState, Step, compared, testimony
from lampest.estimate.weights import Objective, with_chosen_weights
from lampest.files.errors import BROKEN
from lampest.files.levels import Witness
from lampest.files.process import delayed_interrupt, ended_where_hung
from lampest.files.typed import Configuration
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.floating import common_step
from lampest.panel.readouts.starts import (
    panels_beyond_folds,
    several_panels,
    uniform_branches,
    unseen_scales,
)
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.scene import Scene
from lampest.posterior.linear import UNKNOWN_SD, LinearModel
from lampest.posterior.track import beyond_bounds, beyond_tangents
from lampest.recording.readings import Readings
from lampest.solvers.multistart import best_solution
from lampest.solvers.solution import Settings, Solution, Solver, lower_of

# Cells up to which IPOPT takes some hundredths of a second a frame (docs/studies/formulations.md).
NODAL_CELLS = 144
NODAL_PERIOD = 0.5  # s: period from which this is a few hundredths of the time between frames
# Cells up to which a frame that projected Newton does not solve is given to IPOPT.
FALLBACK_CELLS = 256


@dataclass(frozen=True)
class Method(Configuration):
    """Method of estimation: the value of `formulation:`, a bare word or a word with options.

    Attributes
    ----------
    optimum : bool
        Whether it ends at a verified optimum over the cells, the condition for error bars.
    needs_all_frames : bool
        Whether it needs all frames of a recording at once, the unloaded ones included.

    >>> issubclass(lampest.TruncatedMethod, lampest.Method)
    True
    """

    optimum: ClassVar[bool] = False
    needs_all_frames: ClassVar[bool] = False

    if TYPE_CHECKING:

        @property
        def kind(self) -> str:
            """The name of the method in `formulation:`."""

    def check(self, terms: tuple[Term, ...]) -> None:
        """Raise InputError where the method cannot minimise these terms."""

    def check_scene(self, scene: Scene) -> None:
        """Raise InputError where the method does not support a scene's entry, or its readout."""

    def solver(self, cost: Cost, scene: Scene, settings: Settings, period: float) -> Solver:
        """Return the solver of a cost on frames `period` seconds apart.

        Each process builds a solver once.
        """
        return solver_of(cost, scene.circuit, scene.wiring, "reduced", settings)

    @abstractmethod
    def solution(
        self, solver: Solver, data: Data, previous: Array | None, prepared: Any
    ) -> Solution:
        """Return the solution of a frame.

        Parameters
        ----------
        solver : Solver
        data : Data
        previous : array, shape (1, rows, columns), or None
            Cells to start from, ohm.
        prepared : object
            `SequenceState.prepared`.
        """

    def prepared_by(self, solution: Solution, prepared: Any) -> Any:
        """Return `prepared` of the next frame after a solution; by default unchanged."""
        return prepared

    def joint_start(self, objective: Objective) -> bool:
        """Return whether the baseline is solved together with the first frame; by default never."""
        return False

    def data_and_start(self, state: SequenceState, readings: Readings) -> tuple[Data, Array | None]:
        """Return the data of a frame's solve, and its start.

        Parameters
        ----------
        state : SequenceState
        readings : Readings
            (rows, columns).

        Returns
        -------
        data : Data
            For a joint first pair with the unloaded readings (paper, equations 15 and 21).
        start : array, shape (frames, rows, columns), or None
            Cells in ohm; None for the solver's own start.
        """
        objective = state.estimator
        if self.joint_start(objective) and not state.rested:
            return objective.data(state.resting.together(readings), state.background), None
        background = state.background
        if objective.relative:
            background = self._background_with_previous(state, readings)
        data = replace(objective.data(readings.alone(), background), first=state.first)
        several = state.scene.wiring is None and several_panels(
            state.scene.circuit, *state.scene.panel.shape
        )
        start = state.previous
        if start is None:
            # Of several panels that give the same readings the one nearest to the unloaded panel is
            # meant.
            panels = uniform_branches(state.scene.circuit, state.resting.value)
            if several and state.panels is not None:
                start = state.panels.resting
            elif panels:
                start = panels[0][1]
        elif several and state.rested and readings.plain.all():
            start = self._nearest_panel(state, start, data, readings)
        if several and start is not None:
            # Other starts end at other panels, which may have less cost.
            data = replace(data, first=False)
        return data, None if start is None else np.clip(start, data.lower[0], data.upper[0])[None]

    def _nearest_panel(
        self, state: SequenceState, previous: Array, data: Data, readings: Readings
    ) -> Array:
        """Return the panel that gives a frame's readings and differs least from the unloaded one.

        The panels are found from known panels. The result are the previous cells where none is
        found.
        """
        from lampest.inference.circuits.alike import nearest_panel, noise_share

        known = [previous, state.baseline_resistance]
        if state.panels is not None:
            known.append(state.panels.loaded)
        panels = panels_beyond_folds(
            state.scene.circuit,
            readings.value,
            (data.lower[0], data.upper[0]),
            noise_share(readings),
            [cells for cells in known if np.isfinite(cells).all()],
        )
        return nearest_panel(panels, state.baseline_resistance) if panels else previous

    def _background_with_previous(self, state: SequenceState, readings: Readings) -> Background:
        """Return the background of a frame with the previous frame and the baseline.

        Where a term weighs the previous frame, its error bars are included, and the previous cells
        have the level of the frame.
        """
        previous = state.previous
        if previous is None:
            previous = state.scene.circuit.uniform_start(readings.value)
        baseline = None if state.baseline is None else state.baseline.estimate(0)
        background = replace(state.background, previous=previous, baseline=baseline)
        if not state.estimator.weighs_previous:
            return background
        # Open cells and those without error bars have the standard deviation UNKNOWN_SD.
        deviation = np.full(previous.shape, UNKNOWN_SD)
        if state.track is not None and state.track.deviation is not None:
            deviation = np.fmin(state.track.deviation, deviation)
        background = replace(background, previous_deviation=deviation)
        if not state.scene.circuit.two_point:
            return background
        # Remove the step that all cells have in common, so that the previous cells predict the
        # frame's level.
        data = state.estimator.data(readings.alone(), background)
        chosen = data.plain[0]
        expected = data.network(0, previous).reading()[chosen]
        step = common_step(data.measured[0][chosen], expected)
        return replace(background, previous=previous * step)

    def solve(self, state: SequenceState, data: Data, previous: Array | None) -> Step:
        """Return one solve, choosing the weights that are left to the data.

        Parameters
        ----------
        state : SequenceState
        data : Data
        previous : array, shape (1, rows, columns), or None
            Cells to start from, ohm.
        """
        objective = state.estimator
        with delayed_interrupt():
            begin = perf_counter()
            limit = objective.solver.time_limit_s
            if objective.automatic:
                objective = with_chosen_weights(
                    objective, state.scene, data.limited(limit), previous
                )
            choice = perf_counter() - begin
            cost = objective.cost(state.scene, len(data.measured), partial=data.partial)
            solver = self.solver(cost, state.scene, objective.solver, state.period)
            solver.prepare()  # compilation does not count as solve time
            begin = perf_counter()
            with ended_where_hung(limit):
                solution = self.solution(solver, data.limited(limit), previous, state.prepared)
            return Step(
                solution,
                choice + perf_counter() - begin,
                tuple(solver.cost.weights.tolist()),
                weight_sigma=objective.weight_sigma,
            )

    def begin(self, state: AnyState) -> AnyState:
        """Return the state with its baseline, which is solved alone."""
        absolute = state.without_comparisons()
        first = self.solve(absolute, *self.data_and_start(absolute, state.resting))
        settled, baseline = self._with_contacts(absolute, state.resting, first)
        state = replace(state, scene=settled.scene, track=settled.track)
        model = baseline.surroundings()
        if state.track is not None and model is not None:
            with suppress(*BROKEN):
                track = state.track.resting(model, remembered=state.estimator.relative)
                if track.baseline is not None and state.resting.partial:
                    beyond = self._beyond(absolute, state.resting, baseline, model)
                    track = replace(track, baseline=track.baseline.reaching_farther(*beyond))
                state = replace(state, track=track)
        # The baseline is also the previous estimate of the first frame.
        return replace(state, baseline=baseline, previous=baseline.estimate(0))

    def _with_contacts(
        self, state: AnyState, readings: Readings, solved: Step
    ) -> tuple[AnyState, Step]:
        """Return the state with the contacts that its scene requests, and the step for them."""
        if state.scene.contact_prior is None:
            return state, solved
        from lampest.estimate.contacts import with_contacts

        return with_contacts(state, readings, solved, self._elsewhere)

    def push(self, state: AnyState, readings: Readings) -> tuple[AnyState, Step]:
        """Solve one frame's readings (rows, columns).

        Returns
        -------
        state : SequenceState
            State after the frame.
        step : Step
            Solution of the frame.
        """
        data, start = self.data_and_start(state, readings)
        step = self.solve(state, data, start)
        if len(data.measured) == 2:
            state, step = self._with_contacts(state, readings, step)
        return self.after(state, step, readings)

    def verified(
        self, state: AnyState, readings: Readings, after: AnyState, step: Step
    ) -> tuple[AnyState, Step]:
        """Compare the step of a frame with a second solve, by IPOPT from another start.

        A lower optimum of the witness takes the place of the first one.

        Parameters
        ----------
        state : SequenceState
            State before the frame.
        readings : Readings
            The frame, (rows, columns).
        after, step
            State after the frame, and its step.

        Returns
        -------
        after, step
            State after the frame, and its step with the comparison.
        """
        weighted = state.estimator.with_weights(step.weights, step.weight_sigma)
        before = replace(state, estimator=weighted)
        data, previous = self.data_and_start(before, readings)
        cost = before.estimator.cost(state.scene, len(data.measured), partial=data.partial)
        witness = testimony(cost, data, previous, state.estimator.solver)
        comparison = compared(step.solution, witness)
        step = replace(step, verification=comparison)
        if comparison.witness is Witness.LOWER:
            after, step = self.after(before, replace(step, solution=witness), readings)
            after = replace(after, estimator=state.estimator)
        return after, step

    def after(self, state: AnyState, step: Step, readings: Readings) -> tuple[AnyState, Step]:
        """Update the state by a solved frame.

        Returns
        -------
        state : SequenceState
            State after the frame.
        step : Step
            The step, with error bars where the state requests them.
        """
        track = state.track
        model = step.surroundings()
        begin = perf_counter()
        if track is not None and model is not None:
            with suppress(*BROKEN):
                advanced, bars, model = track.advanced(model)
                if readings.partial:
                    bars = bars.reaching_farther(*self._beyond(state, readings, step, model))
                    if state.estimator.penalised:
                        bars = bars.reaching_farther(*beyond_bounds(model, bars.frame.below))
                track = advanced
                step = replace(step, bars=bars, bars_seconds=perf_counter() - begin)
        prepared = self.prepared_by(step.solution, state.prepared)
        estimate = step.estimate(-1)
        step = step.bare()
        baseline = step if len(step.solution.cell_resistance) == 2 else state.baseline
        state = replace(state, baseline=baseline, prepared=prepared, track=track)
        if estimate is not None:
            if track is not None and step.bars is None:
                track = replace(track, deviation=None)  # that of an earlier frame
            state = replace(state, previous=estimate, track=track, first=False)
        return state, step

    def sequence(
        self, state: AnyState, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple[AnyState, list[Step]]:
        """Solve all measured frames of a recording; only for methods with `needs_all_frames`.

        Parameters
        ----------
        state : SequenceState
        resting : Readings
            The unloaded frames, (frames, rows, columns); the state has their mean.
        readings : Readings
            The measured frames, (frames, rows, columns).
        on_frame : callable
            Called after every frame.

        Returns
        -------
        state : SequenceState
            State after the last frame.
        steps : list of Step
            One step a frame.
        """
        raise TypeError(f"{self.kind} takes frames one by one")

    def _elsewhere(self, state: SequenceState, readings: Readings, near: Array) -> Step:
        """Return the step of a frame solved with another state or other readings.

        `near` are the cells at which the solve starts.
        """
        return self.solve(
            state, replace(self.data_and_start(state, readings)[0], first=False), near
        )

    def _beyond(
        self, state: SequenceState, readings: Readings, solved: Step, model: LinearModel
    ) -> tuple[Array, Array]:
        """Return by how much the intervals of log r exceed those of linear theory.

        See `beyond_tangents`.
        """

        def moved(readings: Readings) -> Array:
            ended = self._elsewhere(state, readings, solved.solution.cell_resistance)
            return np.log(ended.cell_resistance / solved.cell_resistance)

        missing = readings.missing(state.scene)
        return beyond_tangents(
            model, readings, missing, None if state.estimator.penalised else moved
        )


@dataclass(frozen=True)
class OptimalMethod(Method):
    """The optimum argmin Σ weight·loss(residual) within the bounds.

    A certificate verifies the optimum independently of the solver.

    Attributes
    ----------
    kind : {'per_pixel', 'nodal', 'reduced', 'auto'}
        Formulation, see `solver`.
    joint : bool
        Whether terms that compare frames solve the baseline together with the first frame (paper,
        equations 15 and 21), rather than the baseline alone and the first frame against it.

    >>> lampest.Estimator((lampest.Misfit(),), lampest.OptimalMethod(kind="reduced")).method.kind
    'reduced'
    """

    optimum = True
    kind: Literal["per_pixel", "nodal", "reduced", "auto"] = "nodal"
    joint: bool = False

    def joint_start(self, objective: Objective) -> bool:
        """Return whether the baseline is solved together with the first frame.

        Terms that weigh the previous frame by its uncertainty exclude it, because they need the
        baseline as the first previous frame.
        """
        return self.joint and objective.relative and not objective.weighs_previous

    def solver(self, cost: Cost, scene: Scene, settings: Settings, period: float) -> Solver:
        """Return the solver of the formulation.

        'per_pixel' and 'nodal' are solved by IPOPT with node voltages as unknowns, 'reduced' by
        Newton's method with potentials eliminated. 'auto' is nodal where IPOPT takes a few
        hundredths of the time between frames, else reduced: on panels of up to NODAL_CELLS with
        squared losses, if frames are at least NODAL_PERIOD apart, one panel gives their readings,
        and the readings show the scale of all cells.
        """
        kind = self.kind
        if kind == "auto":
            squared = all(term.loss.squared for term in cost.terms)
            few = cost.panel.crossings <= NODAL_CELLS
            # From its start IPOPT may end at another panel that reads alike. Along scales that no
            # reading shows, its iterates wander until their limit (docs/studies/speed.md).
            unseen = unseen_scales(scene.circuit, *cost.panel.shape)
            several = several_panels(scene.circuit, *cost.panel.shape)
            fast = few and squared and not several and not unseen
            kind = "nodal" if fast and period >= NODAL_PERIOD else "reduced"
        return solver_of(cost, scene.circuit, scene.wiring, kind, settings)

    def solution(
        self, solver: Solver, data: Data, previous: Array | None, prepared: Any
    ) -> Solution:
        """Return the lowest optimum of a frame's starts.

        `prepared` is the carried state of an earlier solution, or None. With auto a frame that one
        solver does not end at an optimum is given to the other one, from the same starts; so is one
        that IPOPT does not end at a strict optimum, because the other one holds more digits.
        """
        solution = best_solution(solver, data, previous, prepared)
        is_newton = solver.cells_alone
        # Of several panels that read alike, IPOPT may end at another one than it began at, because
        # it moves away from its start; Newton's method does not.
        astray = False
        several = not is_newton and several_panels(data.readout, *data.measured.shape[-2:])
        if several and previous is not None and solution.solved:
            from lampest.inference.circuits.alike import STILL

            moved = np.abs(np.log(solution.cell_resistance / previous))
            astray = bool(np.median(moved) > STILL)
        enough = solution.optimum if is_newton else solution.strict
        many = is_newton and solver.cost.panel.crossings > FALLBACK_CELLS
        if not astray and (self.kind != "auto" or enough or many or data.overdue):
            return solution
        kind = "nodal" if is_newton else "reduced"
        other = solver_of(solver.cost, data.readout, data.wiring, kind, solver.settings)
        second = best_solution(other, data, previous)
        if astray:
            return second if second.optimum else solution
        first = (second, solution) if second.strict else (solution, second)
        return lower_of(*first)

    def prepared_by(self, solution: Solution, prepared: Any) -> Any:
        """Return the state of a single frame's solution that the next one carries, else None."""
        single = len(solution.cell_resistance) == 1
        return solution.carried if solution.solved and single else None


@lru_cache(maxsize=32)
def solver_of(
    cost: Cost, readout: Readout, wiring: Wiring | None, kind: str, settings: Settings
) -> Solver:
    """Return the solver of a formulation: IPOPT on a program, or projected Newton."""
    if kind == "reduced":
        from lampest.solvers.projected_newton import ProjectedNewton

        return ProjectedNewton(cost, settings)
    from lampest.solvers.by_ipopt import Ipopt

    return Ipopt(cost, settings, readout, wiring, kind)
