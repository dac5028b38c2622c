"""The paper's figures and table, with a third side: the paper's panel as its solver leaves it.

Run it with: python -m docs.studies.paper [--out DIR] [--jobs N]
"""

from dataclasses import replace
from pathlib import Path

from docs.studies import script
from docs.studies.as_published import left_by_solver
from docs.studies.paper_figures import MEASURED, TIME, Published, Side, paper_study, shown, unloaded
from lampest.report.compare import statistics


def its_solver(panel: Side, published: Published) -> Side:
    """Return the side that the paper's solver leaves.

    Times are evaluations, at the time that one took the paper.
    """
    changes = {}
    steps = {}
    methods = (
        {record.method for record in published.ranges}
        | {record.method for record in published.errors}
    ) - {MEASURED}
    for method, number in (
        *((method, 0) for method in sorted(methods)),
        (published.mouth_method, 1),
    ):
        mouth = panel.mouths[number]
        frames = mouth.recorded[mouth.measured_frames()]
        results = left_by_solver(method, mouth.scene.panel, unloaded(mouth), frames)
        changes[method, number] = results.change
        parts = (
            {"initial": slice(1), "following": slice(1, None)}
            if results.joint
            else {"all": slice(None)}
        )
        for name, part in parts.items() if not number else ():
            figures = statistics(results.data_error[part], "data error {} [%]", "mean", "sd")
            # Table I: LSM's 16.45 ± 0.40 s are its limit of 10,000 evaluations and one derivative.
            steps[method, name] = figures | {
                TIME[3]: 16.45 / 10_100 * float(results.evaluations[part].mean())
            }
    return shown(replace(panel, name="its solver", word="solver", changes=changes, steps=steps))


if __name__ == "__main__":
    parser = script.parser_of(__doc__)
    parser.set_defaults(out=Path("results/paper"))
    parser.add_argument("--jobs", type=int, help="processes; default: all cores")
    script.main(lambda options: paper_study(options.out, options.jobs, its_solver), parser)
