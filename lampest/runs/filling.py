"""Conversion of estimates to the content of a results file.

The module also converts attributes of the file to the noise of frames.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields
from functools import cache

import numpy as np

from lampest.cost.terms import term_kind
from lampest.estimate.estimates import Estimates
from lampest.files.document import plain_content, to_yaml
from lampest.panel.panel import Array
from lampest.panel.readouts.scan_order import by_columns
from lampest.panel.scene import Scene
from lampest.posterior.frame_noise import FrameNoise
from lampest.runs.case import FIGURES, CaseResult, all_columns
from lampest.runs.columns import Columns
from lampest.runs.config import Case, hash_of
from lampest.runs.content import Content
from lampest.runs.provenance import library_versions

# Stored name → attribute of `FrameNoise`: two numbers, two patterns in volt, and
# fractions of the readings.
NOISE = {
    "gain": "gain",
    "unloaded": "unloaded",
    "together": "common_ripple",
    "apart": "line_ripple",
    "motion": "motion",
}


def case_result(case: Case, estimates: Estimates, *, checked: bool = False) -> CaseResult:
    """Return the result of a run's case, with all columns that its estimates provide.

    Raises InputError where the values of a column have a wrong shape or are impossible.

    Parameters
    ----------
    case : Case
    estimates : Estimates
    checked : bool
        Whether the circuit is checked for it; else the check is a task of its own.
    """
    names = {
        "recording": case.recording,
        "estimator": case.name,
        "case_id": case.case_id,
        "case_yaml": case.resolved,
    }
    if case.swept:
        names["swept_json"] = json.dumps(case.swept)
    return _filled(estimates, (), names, checked=checked)


def named_result(
    estimates: Estimates,
    name: str | None,
    columns: Columns,
) -> CaseResult:
    """Return the result of estimates without a run file. Raises InputError as `case_result`.

    Parameters
    ----------
    estimates : Estimates
    name : str or None
        Name of the estimator; None: its terms, such as `misfit + gradient`.
    columns : sequence of Column
        Columns besides those of lampest and of installed packages.
    """
    recording = estimates.recording
    estimator = estimates.estimator
    if name is None:
        name = " + ".join(map(term_kind, estimator.terms))
    names = {"recording": recording.name, "estimator": name}
    content = names | {"readings_sha256": hashlib.sha256(recording.recorded.tobytes()).hexdigest()}
    resolved = to_yaml(content | plain_content(recording.scene) | plain_content(estimator))
    names |= {"case_id": hash_of(resolved), "case_yaml": resolved}
    return _filled(estimates, columns, names, checked=True)


def _filled(
    estimates: Estimates, columns: Columns, names: dict[str, str], *, checked: bool
) -> CaseResult:
    """Return the case with every column, attribute and figure that its estimates provide.

    Parameters
    ----------
    estimates : Estimates
    columns : sequence of Column
        Columns besides those of lampest and of installed packages.
    names : mapping
        Names of recording and estimator, and the resolved case, by field.
    checked : bool
        Whether the case has the check of the circuit and advice.
    """
    doubts = (
        _audited(estimates)
        if checked
        else {"warnings": "\n".join(estimates.checks_without_circuit)}
    )
    table = all_columns(columns)
    values = {column.name: column.filled(estimates) for column in table}
    result = CaseResult.of(
        {column: held for column, held in values.items() if held is not None},
        **names,
        versions=library_versions(),
        scene=estimates.recording.scene,
        frame_noise=_arrays_of(estimates.noise.frame),
        start_time=estimates.recording.start_time or "",
        **{
            item.name: item.metadata["value"](estimates)
            for item in fields(Content)
            if item.metadata.get("value")
        },
        **doubts,
        **{folder.name: folder.value(estimates) for folder in FIGURES},
    )
    result.check(table)
    return result


def _audited(estimates: Estimates) -> dict[str, str]:
    """Return the verdict on the circuit, the advice and the warnings of estimates by field."""
    # An import for the check alone, which runs make later.
    from lampest.audit.advice import Audit, verdict

    audit = Audit(estimates.prepared)
    check = verdict(estimates.circuit_check, estimates.prepared, audit.health)
    return {
        "model_mark": check.mark,
        "model_sentence": check.sentence,
        "advice": "\n".join(audit.lines),
        "warnings": "\n".join(estimates.checks),
    }


@cache
def _arrays_of(noise: FrameNoise | None) -> dict[str, Array]:
    """Return the numbers and the patterns in volt of a frame's noise by name, if any."""
    parts = {} if noise is None else {name: getattr(noise, part) for name, part in NOISE.items()}
    return {
        name: np.array(part, dtype=float, order="C")
        for name, part in parts.items()
        if np.size(part)
    }


def frame_noise_of(arrays: Mapping[str, Array], scene: Scene) -> FrameNoise | None:
    """Return the frame noise of stored arrays, the inverse of `_arrays_of`.

    Raises ValueError for invalid arrays.
    """
    if scene.readout is None or not arrays:
        return None
    channels = scene.panel.shape[0 if by_columns(scene.circuit) else 1]
    none = np.zeros((channels, 0))
    still = {"together": none, "apart": none, "motion": np.zeros(0)}
    complete = {"gain": np.nan, "unloaded": np.nan, **still, **arrays}
    parts = [np.asarray(complete[name]) for name in NOISE]
    gain, unloaded, *roots, motion = parts
    if any(array.dtype.kind not in "iuf" or not np.isfinite(array).all() for array in parts):
        raise ValueError("frame_gain and what belongs to it must be finite numbers")
    if gain.shape or unloaded.shape or gain < 0 or unloaded < 1:
        raise ValueError("frame_gain must not be negative, frame_unloaded at least 1")
    if any(root.ndim != 2 or len(root) != channels for root in roots):
        raise ValueError(
            f"frame_together and frame_apart must have {channels} rows, "
            "one for each channel of a line"
        )
    if motion.shape not in ((0,), (3,)):
        raise ValueError("frame_motion must have three numbers")
    return FrameNoise(
        scene,
        int(unloaded),
        float(gain),
        *(root.astype(float) for root in roots),
        motion=motion.astype(float),
    )
