"""Cell resistances of passive resistive matrix sensors from readings with crosstalk.

    import lampest
    recording = lampest.Recording.load("data/lamprey_35mm.h5")
    estimate = lampest.reconstruct(recording, [lampest.Misfit(), lampest.Gradient(weight=1e-3)])
    estimate.cell_resistance  # (frames, rows, columns) ohm
    estimate.relative_change  # percent of the unloaded panel
    estimate.plot()

Names are loaded when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import lazy_loader

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lampest.cost.terms import Term
    from lampest.estimate.estimator import Tare, Verify
    from lampest.estimate.methods import MethodName
    from lampest.estimate.methods.method import Method
    from lampest.estimate.weights import AutoWeight
    from lampest.formulation.constraints import ProgramPart
    from lampest.recording.recording import Recording
    from lampest.report.reconstruction import Reconstruction
    from lampest.solvers.posed import Bounds
    from lampest.solvers.solution import Settings

# The public names are those of __init__.pyi, which editors and type checkers read, too.
_attribute, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = sorted({*_names, "reconstruct"} - {"MethodName"})


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted([*__all__, "__all__", "__doc__", "__version__"])


def __getattr__(name: str) -> object:
    """Return a public name, which is loaded when it is first used."""
    if name == "__version__":
        from importlib.metadata import version

        return version("lampest")
    if name == "datasets":  # a module, and not yet an attribute of its room
        from lampest.recording import datasets

        return datasets
    if name not in _names:
        raise AttributeError(f"module 'lampest' has no attribute '{name}'")
    from lampest.files.errors import InputError, extra

    try:
        with extra():
            return _attribute(name)
    except ModuleNotFoundError as error:
        room, _, rest = (error.name or "").removeprefix("lampest.").partition(".")
        if room != "apps":
            raise
        application = rest.partition(".")[0]
        raise InputError(f"{name}: the application '{application}' is not installed") from error


def reconstruct(
    recording: Recording,
    terms: Sequence[Term] | None = None,
    *,
    formulation: MethodName | Method = "auto",
    solver: Settings | None = None,
    bounds: Bounds | None = None,
    error_bars: Literal["auto"] | bool = "auto",
    auto_weight: AutoWeight | None = None,
    tare: Tare | None = None,
    verify: Verify | None = None,
    constraints: Sequence[ProgramPart] | None = None,
    progress: bool | Callable[[int, int], None] = False,
) -> Reconstruction:
    """Estimate the cells of every measured frame.

    The estimate r̂ minimises Σ weight·loss(residual) within the bounds.

    Parameters
    ----------
    recording : Recording
        Frames and scene, as `Recording.load`, `simulate` and `import_file` return them.
    terms : sequence of Term, or None
        Cost terms, such as [Misfit(), Gradient(weight=1e-3)]; a penalty without a weight has
        'auto'. None stands for [Misfit(weighting="noise"), LogGradient()], with a plain misfit
        where the noise is unknown.
    formulation : str or Method
        Computation of the estimate: a word, or a method with its options such as
        TruncatedMethod(steps=4). 'auto': nodal or reduced, by the panel's size and the time between
        frames.
    solver : Settings, or None
        None stands for Settings().
    bounds : Bounds, or None
        None stands for Bounds().
    error_bars : 'auto' or bool
        'auto' computes them for panels of up to 600 cells whose noise is known.
    auto_weight : AutoWeight, or None
        None stands for AutoWeight().
    tare : Tare, or None
        When the zero of pressures is taken anew; None: never.
    verify : Verify, or None
        Frames that IPOPT solves again on the nodal program, from another start. None stands for
        Verify(): none.
    constraints : sequence of ProgramPart, or None
        Own parts of the program of every frame, such as EqualCells(cells=[[0, 0], [0, 1]]); they
        need the formulation nodal, per_pixel or auto.
    progress : bool or callable
        True draws a bar with the numbers of finished and of all frames and the remaining time. A
        function is called after every frame with both numbers.

    Returns
    -------
    Reconstruction
        With arrays such as `cell_resistance`, (frames, rows, columns) ohm, and `relative_change`,
        percent.

    Raises
    ------
    InputError
        If an argument is of another type, or recording and estimator do not fit.

    Examples
    --------
    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit(), lampest.Gradient(weight=1e-3)])
    >>> estimate.cell_resistance.shape
    (2, 2, 3)
    """
    from lampest.estimate.estimator import Estimator, checked_terms
    from lampest.estimate.sequence import default_terms
    from lampest.report.reconstruction import Reconstruction

    options = {
        "solver": solver,
        "bounds": bounds,
        "auto_weight": auto_weight,
        "tare": tare,
        "verify": verify,
        "constraints": None if constraints is None else tuple(constraints),
    }
    estimator = Estimator(
        default_terms(recording) if terms is None else checked_terms(terms),
        formulation,
        error_bars=error_bars,
        **{name: value for name, value in options.items() if value is not None},
    )
    if progress is not True:
        return Reconstruction.of(recording, estimator, progress or (lambda done, frames: None))
    from lampest.cli.screen import progress as progress_bar

    with progress_bar("frames", counted=True) as on_frame:
        return Reconstruction.of(recording, estimator, on_frame)
