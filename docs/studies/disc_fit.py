"""Whether the fit of a disc is needed: place and diameter by it, and by the risen cells alone.

Run it with: python -m docs.studies.disc_fit [--scenes 4] [--seed 52]

Ten seconds after the touch the fit of `lampest detect` is compared with the risen cells: their
centroid, weighted with ln r/r0, and the diameter of a disc with the same area of suction and a rim
of 6 mm. Films, circuits and loads are drawn, as by `docs.studies.words --drawn`.
"""

import argparse

import numpy as np

from docs.studies.attachments import (
    CUP_CURRENT,
    CURRENT,
    DRAWN,
    LEAKING,
    MOVING,
    TOUCH_S,
    UNLOADED,
    recording,
)
from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.detect.answer import Detected
from lampest.apps.recognition.detect.detection import known_of, measured_frames
from lampest.apps.recognition.suction import RIM_MM
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array, Panel

RATE_HZ = 4.0
SHOWN_S = 10.0  # after the touch
MOUTHS = ("mouth", "uneven mouth", "wavy mouth", "mouth and body", "pressed mouth", CURRENT, MOVING)
CUPS = ("cup", CUP_CURRENT, LEAKING, "cup and body")
NAMES = ("fit", "risen cells")


def by_risen_cells(panel: Panel, load: Attachment) -> tuple[float, float, float] | None:
    """Return x, y and diameter in mm by the risen cells of a load; None without any."""
    if load.held is None or not load.held.risen.any():
        return None
    risen = load.held.risen
    weight = load.held.change[risen] / load.held.change[risen].sum()
    x, y = panel.places_mm[:, risen] @ weight
    inner = 2 * np.sqrt(risen.sum() / np.pi) * panel.pitch_mm
    return float(x), float(y), float(inner + 2 * RIM_MM[0])


def errors(kind: str, seed: int) -> Array | None:
    """Return the errors of place and diameter, mm, (2, 2): by the fit, and by the risen cells.

    None where nothing sucks.
    """
    whole, made, _, _ = recording(kind, RATE_HZ, seed, curve=DRAWN)
    watched = known_of(Prepared(whole))
    if isinstance(watched, Detected):
        return None
    watch = watched.watch()
    shown_s = float(whole.time[UNLOADED]) + TOUCH_S + SHOWN_S
    asked = whole.time <= shown_s
    for value, sigma, time in measured_frames(whole, watched, asked):
        watch = watch.push(value, sigma, time)
    load = Detected.of(kind, watch.attachments, RATE_HZ).chosen
    cells = None if load is None else by_risen_cells(whole.scene.panel, load)
    if load is None or load.diameter_mm is None or cells is None:
        return None
    fit = (*load.place, load.diameter_mm[0])
    x, y = made.centres_mm[0]
    return np.array(
        [(np.hypot(own[0] - x, own[1] - y), own[2] - made.diameters_mm[0]) for own in (fit, cells)]
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=4, help="of every kind")
    parser.add_argument("--seed", type=int, default=52)
    given = parser.parse_args()
    found = [
        errors(kind, 1000 * given.seed + number)
        for number in range(given.scenes)
        for kind in (*MOUTHS, *CUPS)
    ]
    known = np.array([each for each in found if each is not None])
    print("| place and size | loads | place: median, 90 % [mm] | diameter: bias, scatter [mm] |")
    print("|---|---|---|---|")
    for name, (place, size) in zip(NAMES, known.transpose(1, 2, 0), strict=True):
        print(
            f"| {name} | {len(known)} | {np.median(place):.1f}, {np.quantile(place, 0.9):.1f} "
            f"| {np.median(size):.1f}, {size.std():.1f} |"
        )
