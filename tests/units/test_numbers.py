"""Numbers that the pages state are those of the package."""

from math import exp
from pathlib import Path

import pytest

from lampest.apps.board import several, stream
from lampest.apps.film import tare
from lampest.apps.recognition import (
    breath,
    breathing,
    hypotheses,
    pumping,
    suction,
    watch,
    watch_parts,
)
from lampest.estimate import estimator, sequence
from lampest.estimate.methods import method
from lampest.files import hdf5, levels, process
from lampest.inference import noise, nuisances, variance_components
from lampest.inference.circuits import model_check, open_ends
from lampest.inference.circuits import parameters as alternative_parameters
from lampest.panel import trust_region
from lampest.posterior import reference, sampled, track
from lampest.recording import stored
from lampest.solvers import certificate, posed, projected_lbfgs, solution

ROOT = Path(__file__).parents[2]
STATED: dict[str, list[tuple[str, float, float]]] = {
    "docs/theory/inverse_problem.md": [
        ("the residual is at most 10⁻⁶", solution.VERIFIED, 1e-6),
        ("more than a thousandth of its standard deviation", certificate.DEVIATION_SHARE, 1e-3),
        ("the upper bound is 10⁹ times the readout's apparent", posed.OPEN_FACTOR, 1e9),
        ("at a millionth of its apparent resistance", posed.SHORT_FACTOR, 1e-6),
    ],
    "docs/theory/solver.md": [
        ("the step below $10^{-8}$", projected_lbfgs.LAST_STEP, 1e-8),
        ("a move of 0.1 is enough", projected_lbfgs.CERTIFIED_DISTANCE, 0.1),
        ("up to 256 cells that can move", trust_region.DENSE_CELLS, 256),
        ("or 600 with absolute losses or two frames", trust_region.MATRIX_CELLS, 600),
        ("the corrections of the last four steps", projected_lbfgs.MAX_PAIRS, 4),
    ],
    "docs/theory/posterior.md": [
        ("a factor of at least 1.25", variance_components.MIN_EXCESS, 1.25),
        ("with three degrees of freedom", reference.DEGREES_OF_FREEDOM, 3),
    ],
    "docs/theory/model_check.md": [
        (
            "An alternative is named if its evidence is e¹⁸ times larger",
            nuisances.MIN_EVIDENCE_GAIN,
            36,
        ),
        ("another circuit is better by 15 in", alternative_parameters.DOUBTFUL_GAIN, 15),
        ("a resistance in series that changes cells by 5 %", open_ends.DOUBTFUL_SHIFT, 0.05),
        ("must exceed e⁷·⁵", alternative_parameters.DOUBTFUL_GAIN, 2 * 7.5),
        ("If more than a tenth of the readings is missing", model_check.MAX_MISSING, 0.1),
        ("On panels of more than 400 cells", reference.MAX_CELLS, 400),
    ],
    "docs/theory/recognition.md": [
        ("with a time constant of 20 s", watch_parts.FOLLOWS_S, 20),
        ("A change has to exceed half of it.", watch.MIN_CHANGE, 0.5),
        ("more than 80 % of its resistances", watch_parts.OPEN_SHARE, 0.8),
        ("exceed twice those at rest", watch_parts.OPEN_RATIO, 2),
        ("The longest time between two looks is a minute.", watch.LOOKS_S, 60),
        ("an interquartile range of ln r₀ of 0.9", suction.MAX_RANGE, 0.9),
        ("A window is full after 8 s.", breathing.WINDOW_S, 8),
        ("From 3.5 s on, incomplete windows count", breathing.MIN_WINDOW_S, 3.5),
        ("its rate wanders by 6 %", hypotheses.WANDER, 0.06),
        ("begin to leak, in one window of twenty", hypotheses.LEAK_SHARE, 0.05),
        ("at N(0, 0.3²) a second", hypotheses.LEAK_SD, 0.3),
        ("(E_rim/E_own)^½/10", hypotheses.RIM.odds, 10),
        ("(E_moves/E_own)^½/10", hypotheses.MOVES.odds, 10),
        ("(1/E_own)^½/30", hypotheses.BESIDE.odds, 30),
        ("4.3 times less probable beforehand", round(hypotheses.PRIOR_ODDS, 1), 4.3),
        ("The 10 and the 30 are then 0.1", hypotheses.RIM.odds_adjoined, 0.1),
        ("each by itself, by at most 5 %", hypotheses.BESIDE.largest, 0.05),
        ("its prior probability of 0.81", round(breathing.PRIOR_SUCTION, 2), 0.81),
        ("excludes a breath of 3 % or more", hypotheses.MIN_DEPTH, 0.03),
        ("its depth and 1.645 standard deviations", breathing.ONE_SIDED, 1.645),
        ("w = ln(0.1 + 0.9 B)", exp(-hypotheses.SILENT_LOG_ODDS), 0.1),
        ("with A = 4.5 % for breathing", hypotheses.BREATHING_SD, 0.045),
        ("and 0.2 % without", hypotheses.TREMBLE_SD, 0.002),
        ("a is at most 15 % of the suction", hypotheses.BREATH.largest, 0.15),
        ("Below 3.8 frames a second", breath.MIN_RATE_HZ, 3.8),
        ("Rates above 0.475 of the frame rate", breath.MAX_RATE_SHARE, 0.475),
        ("between 0.5 and 2.5 Hz", hypotheses.RATES_HZ[1] - hypotheses.RATES_HZ[0], 2),
        ("A sample is the median of the frames of 3 s", pumping.BLOCK_S, 3),
        ("One fifth of all mouths is assumed to show no pumps", pumping.HIDDEN_SHARE, 0.2),
        ("one cup in twenty to be pressed on as often", pumping.RESTORED_SHARE, 0.05),
        ("A breath that exceeded P = 0.99", breathing.CERTAIN, 0.99),
        ("The eight most probable times of the last jump", pumping.HYPOTHESES, 8),
    ],
    "docs/apps/recognition/detect.md": [
        ("by three standard deviations, by 5 %", levels.NOISE_REACH, 3),
        ("and by a twentieth of the strongest change", suction.GHOST_SHARE, 0.05),
        ("falls below three tenths of the weaker one's", suction.FAINT_SHARE, 0.3),
        ("at less than 15 % of the strongest", suction.SMALL_SHARE, 0.15),
        ("Panels of more than 1024 cells", watch.MAX_CELLS, 1024),
    ],
    "docs/howto/methods.md": [
        ("up to 144 cells", method.NODAL_CELLS, 144),
        ("at no more than two frames a second", 1 / method.NODAL_PERIOD, 2),
        ("on panels of up to 256 cells", method.FALLBACK_CELLS, 256),
        ("on panels of at most 144 cells", estimator.MAX_VERIFIED_CELLS, 144),
    ],
    "docs/howto/error_bars.md": [
        ("every verified estimate of up to 600 cells", trust_region.MATRIX_CELLS, 600),
        ("beyond 1,200 unknowns", trust_region.MAX_DENSE, 1200),
        ("from 100 samples", sampled.SampledErrors.samples, 100),
    ],
    "docs/howto/readings.md": [
        ("profile intervals for up to three missing readings", track.MAX_MISSING, 3)
    ],
    "docs/howto/batches.md": [
        ("more than 2,000,000 readings", stored.MAX_READINGS, 2e6),
        ("in parts of 500,000", stored.PART_READINGS, 5e5),
        ("the first 500 unloaded frames", sequence.LEAD_FRAMES, 500),
        ("refuse more than 100,000,000 values", hdf5.MAX_VALUES, 1e8),
        ("for two minutes beyond ten limits", process.HUNG_SECONDS, 120),
    ],
    "docs/apps/board/board.md": [
        ("1.5 periods and 0.3 s on", several.LATE_SECONDS, 0.3),
        ("no valid frame ends after 30 s", stream.UNFIT_SECONDS, 30),
    ],
    "docs/apps/film/film.md": [
        ("off by more than 15 % (0.8 kPa)", tare.MAX_CHANGE, 0.15),
        ("by more than 6 % in the mean", tare.MAX_CHANGE_OF_FOUR, 0.06),
    ],
    "docs/faq.md": [("the noise from five or more unloaded frames", noise.MIN_UNLOADED_FRAMES, 5)],
}


@pytest.mark.parametrize("page", STATED)
def test_numbers_of_a_page_are_those_of_the_package(page: str) -> None:
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    assert not [phrase for phrase, _, _ in STATED[page] if phrase not in text]
    assert not [
        (phrase, actual)
        for phrase, actual, stated in STATED[page]
        if actual != pytest.approx(stated)
    ]
