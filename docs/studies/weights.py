"""Selection of weights: evidence, misfit, penalty and true error over λ, with every rule's choice.

Run it with: python -m docs.studies.weights [CONFIG] [--out DIR] [--set PATH=VALUE]

A case has one penalty. `docs.studies.weight_curves` has the true curves over its weight.
"""

import re
from collections.abc import Iterator

from docs.studies import script
from docs.studies.cases import Cases, of_cases
from docs.studies.weight_curves import Choice, Curves, WeightSubject, tune
from docs.studies.weights_figure import weights_figure
from lampest.apps.studies import study
from lampest.cost.terms import Term
from lampest.estimate.estimator import Estimator
from lampest.panel.trust_region import MAX_DENSE
from lampest.recording.recording import Recording
from lampest.report.compare import Columns
from lampest.report.words import text_of
from lampest.runs.config import Case, Run, read_run


def why_not(estimator: Estimator, readings: int) -> str | None:
    """Return the reason why an estimator cannot be tuned with that number of readings, or None."""
    terms: tuple[Term, ...] = estimator.terms
    misfits = sum(term.reads_measurement for term in terms)
    if misfits != 1 or len(terms) != 2:
        penalties = len(terms) - misfits
        return (
            f"it has {penalties} penalty terms, not one"
            if penalties
            else "it has no penalty to weigh"
        )
    if readings > MAX_DENSE:
        return f"one solve has {readings} readings, more than {MAX_DENSE}"
    return None


def tuned(case: Case) -> list[Curves] | str:
    """Tune a case with one penalty, or return the reason why it cannot be tuned."""
    recording = Recording.load(case.path)
    frames = 2 if case.estimator.relative else 1
    reason = why_not(case.estimator, frames * recording.scene.panel.crossings)
    if reason is not None:
        return reason
    subject = WeightSubject.of(case, recording)
    if subject is None:
        return "too little was read of every measured frame"
    curves = tune(subject)
    return [curves] if curves.values("solved").any() else "it was solved for no weight"


def _row(subject: WeightSubject, choice: Choice) -> study.Row:
    return study.Row(
        recording=subject.case.recording,
        estimator=subject.case.name,
        frame=subject.frame,
        rule=choice.rule,
        in_use=int(choice.in_use),
        weight=choice.weight,
        weight_unit=subject.units["weight"],
        rms_log_error=choice.error,
        over_best=choice.excess,
    )


def weight_rows(cases: Cases[Curves]) -> list[study.Row]:
    """Return a row for every case and rule."""
    return [_row(curves.subject, choice) for curves in cases.measured for choice in curves.choices]


SCREEN: Columns = {
    "recording": "{recording}",
    "estimator": "{estimator}",
    "rule": "{rule}",
    "in use": lambda row: "*" * row.in_use,
    "λ": lambda row: text_of(row.weight, ".3g") or "none",
    "unit of λ": "{weight_unit}",
    "true error": "{rms_log_error:.4f}",
    "over the best": "{over_best:.3f}",
}


def _groups(cases: Cases[Curves]) -> Iterator[study.RecordGroup]:
    """Yield the groups /entry/<recording>/<estimator> of the curves and their `choices`."""
    for curves in cases.measured:
        subject = curves.subject
        path = f"{curves.subject.case.recording}/{curves.subject.case.name}"
        about = {
            "frame": subject.frame,
            "readings": subject.count,
            "noise_known": int(subject.data.noise_known),
        }
        yield study.RecordGroup(path, curves.points, "risk", "weight", subject.units, about)
        yield study.RecordGroup(f"{path}/choices", curves.choices, "weight", units=subject.units)


STUDY: study.Study[Run, Cases[Curves]] = study.Study(
    "tune",
    "cases",
    "tune.yaml",
    read_run,
    lambda run, on_step: of_cases(tuned, run, on_step, "tune"),
    rows=weight_rows,
    sheets=lambda cases: [("", weight_rows(cases), SCREEN)],
    form="tune/3",
    records=_groups,
    figures=lambda cases: {
        re.sub(
            r"[^\w.@=,+-]", "_", f"tune_{curves.subject.case.recording}_{curves.subject.case.name}"
        ): weights_figure(curves)
        for curves in cases.measured
    },
    left_out=lambda cases: cases.left_out,
)

if __name__ == "__main__":
    script.main(lambda options: STUDY, script.parser_of(__doc__))
