"""Statistical levels: how improbable under noise a deviation must be before a rule acts.

Each level says its unit, the false alarms that it admits, and the tests that fail without it. Rooms
import levels; no room states one of its own where a level of this table has the same meaning.
"""

from enum import IntEnum

# Standard deviations of a reading. Gaussian noise exceeds it once in 370 readings, on one side once
# in 740. Bounds of cells and rails give way by it, and a cell that answers by more is pressed: with
# 1 % noise the truth itself violates exact bounds in a third of cases
# (tests/laws/test_readouts.py); a resistance below it is indistinguishable from zero
# (tests/laws/test_holes.py).
NOISE_REACH = 3.0

# Standard deviations of one number among a few hundred, such as the change of a cell, the
# difference of two lines, the answer of a load: noise alone exceeds it once in 15,000
# (tests/oracles/test_wires.py, tests/oracles/test_noise.py,
# tests/apps/calibration/test_calibration.py).
UNUSUAL = 4.0

# Standard deviations of a deviation that is named or taken off: noise alone exceeds it once in 1.7
# million numbers, of 32 channels once in 50,000 calibrations (tests/oracles/test_nuisances.py,
# tests/apps/calibration/test_calibration.py). A line that differs from others by this root mean
# square is distinct: panels whose lines are all nearly equal name no touching lines
# (tests/oracles/test_wires.py).
SIGNIFICANT = 5.0

# Standard deviations of one among very many numbers, readings or patterns of all frames: noise
# alone exceeds it once in 500 million, in one of 200,000 recordings of 2,400 readings
# (tests/oracles/test_noise.py, tests/apps/recognition/test_watch.py).
OUTLIER_THRESHOLD = 6.0

# Mean square of about a hundred deviations over their variance: noise alone exceeds it, three
# standard deviations of a mean of a hundred squares, once in 700 frames. Beyond, frames are not at
# rest or a shape does not explain them (tests/apps/film/test_film.py,
# tests/apps/recognition/test_detector.py).
MAX_MEAN_SQUARE = 1.4

# Probability under noise alone of one of a recording's handful of tests: cells that do not explain
# a frame, noise other than specified, what the readings of a frame share, channels that end at one
# voltage: of a few tests each one clean recording in some 2,000 fails
# (tests/oracles/test_model_check.py, test_noise.py and test_nuisances.py).
SIGNIFICANCE = 1e-4

# The same of tests whose false alarm costs little: readings that are left out of a recording as
# outliers, or two frames that are alike and not averaged (tests/oracles/test_reference.py,
# tests/oracles/test_model_check.py).
FALSE_ALARM_RATE = 0.01

# In −2 ln evidence, of another circuit, an effect or an error of the model. 430 recordings with the
# right circuit gain 32 at most, and nearly all less than 15; of 500 others two gain more
# (docs/theory/model_check.md). By an error of the model mouths at their limits gain 23 where
# nothing is wrong, and 76 where readings are off by 7 % each.
MIN_EVIDENCE_GAIN = 36.0
# In the same unit: another circuit may gain up to this without a doubt.
DOUBTFUL_GAIN = 15.0

# Standard deviations of half a 95 % interval of a normal distribution.
TWO_SIDED = 1.959963984540054
# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_SIGMA = 1.4826


class Witness(IntEnum):
    """Result of the second solve of a frame, by IPOPT."""

    NONE = 0
    SAME = 1
    HIGHER = 2
    LOWER = 3
    FAILED = 4
