"""The truth of a recording as the text that simulated_board reads.

Run it with: python truth.py RECORDING > truth.txt.
"""

import sys
from pathlib import Path

from lampest.recording.recording import Recording


def truth_text(time: object, cell_resistance: object) -> str:
    """'frames rows columns', then a line for each frame: time in s, cells in ohm row by row."""
    import numpy as np

    cells = np.asarray(cell_resistance, dtype=float)
    lines = [" ".join(str(size) for size in cells.shape)]
    for moment, frame in zip(np.asarray(time, dtype=float), cells, strict=True):
        lines.append(" ".join(repr(float(value)) for value in (moment, *frame.ravel())))
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    recording = Recording.load(Path(sys.argv[1]))
    if recording.truth_cell_resistance is None:
        sys.exit(f"{sys.argv[1]}: holds no /entry/truth/cell_resistance")
    sys.stdout.write(truth_text(recording.time, recording.truth_cell_resistance))
