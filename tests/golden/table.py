"""The golden table: name → a function that computes numbers or texts.

The functions use public functions of every room.

Most rows come from a walk over a union, so that a new member has one at once. Panels are tiny and
seeds are fixed. `python -m tests.golden.make table` stores the results anew, a file a room in
data/.
"""

from golden.checks import of_checks, of_recognition
from golden.circuits import Rows, of_loads, of_panel
from golden.estimates import of_estimate, of_recording
from golden.inputs import of_inputs
from golden.numerics import of_cost, of_posterior, of_solvers
from golden.outputs import of_report
from golden.runs import of_runs
from golden.studies import of_studies
from golden.whole import of_whole

ROOMS = (
    of_panel,
    of_loads,
    of_cost,
    of_solvers,
    of_posterior,
    of_recording,
    of_inputs,
    of_estimate,
    of_checks,
    of_recognition,
    of_report,
    of_studies,
    of_runs,
    of_whole,
)


def table() -> dict[str, Rows]:
    """Return room → name → function."""
    return {room.__name__.removeprefix("of_"): room() for room in ROOMS}
