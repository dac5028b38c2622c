"""Judgement of a recording's readings: what is wrong in them is missing, or named.

Frozen and garbled readings leave first, then those that no cells give, then outliers of single
frames: what is found is left out before the next question is asked. No reading is replaced.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.files.errors import first_and_more
from lampest.inference.readings.garbled import GarbledLines, garbled_lines, readings_of
from lampest.inference.readings.outliers import (
    impossible_readings,
    no_cell_moves,
    outliers_of_one_frame,
)
from lampest.inference.readings.repeated import frozen_readings
from lampest.panel.panel import Array, Mask
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording


@dataclass(frozen=True, eq=False)
class Cleaned:
    """Readings of a recording without those that are impossible, and the outliers that stay.

    Attributes
    ----------
    recording : Recording
        Its scene includes a saturated stage where the readings show one; frozen and garbled
        readings are missing.
    frozen : boolean array, shape (rows, columns)
    garbled : tuple of GarbledLines
    impossible : boolean array, shape (frames, rows, columns)
        Readings that are larger than any cells allow.
    outliers : boolean array, same shape
        These, and outliers of one frame.
    deviation : array, same shape
        Readings over the predictions of their neighbours in time, less one.
    readings : Readings
        Impossible readings are missing, those of unloaded frames that deviate, and all outliers
        where the scene excludes them.
    """

    recording: Recording
    frozen: Mask
    garbled: tuple[GarbledLines, ...]
    impossible: Mask
    outliers: Mask
    deviation: Array
    readings: Readings

    @classmethod
    def of(cls, recording: Recording) -> "Cleaned":
        """Return the readings of a recording without those that do not belong to it."""
        scene = recording.scene
        unloaded = recording.role == UNLOADED
        frozen = frozen_readings(recording)
        garbled = garbled_lines(recording)
        unread = frozen | readings_of(garbled, recording)
        if unread.any():
            recording = replace(recording, recorded=np.where(unread, np.nan, recording.recorded))
        every = recording.readings()
        impossible = impossible_readings(scene.circuit, every)
        readings = every.without(impossible)
        outlying, expected, scale = outliers_of_one_frame(readings, unloaded)
        value = readings.plain_values
        left_out = outlying & (unloaded[:, None, None] | (scene.outliers == "exclude"))
        for frame in np.flatnonzero((outlying & ~left_out).any(axis=(1, 2))):
            of_frame = (part[frame] for part in (outlying, value, expected, scale))
            left_out[frame] |= no_cell_moves(scene, *of_frame)
        with np.errstate(divide="ignore", invalid="ignore"):
            deviation = every.value / expected - 1
        outliers = outlying | impossible
        readings = readings.without(left_out)
        return cls(recording, frozen, garbled, impossible, outliers, deviation, readings)

    @property
    def left_out(self) -> Mask:
        """Outliers and impossible readings that are missing, boolean (frames, rows, columns)."""
        return np.asarray(self.outliers & (self.readings.seen == 0))

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences on impossible readings, and on outliers that are missing or stay."""
        missing = self.readings.seen == 0
        at_rest = (self.recording.role == UNLOADED)[:, None, None]
        outliers = self.recording.scene.outliers
        kept = "kept; outliers: exclude leaves out such readings"
        if outliers == "robust":
            kept = "kept, with Student's loss"
        exceed = "larger than any cells allow beside the others"
        deviate = ("reading deviates in one frame", "readings deviate in one frame")
        outlying = self.outliers & ~self.impossible
        kinds = (
            (self.impossible, (f"reading is {exceed}", f"readings are {exceed}"), "left out"),
            (
                outlying & missing & at_rest,
                deviate,
                "left out, since no cell changes in unloaded frames",
            ),
            (
                outlying & missing & ~at_rest,
                deviate,
                "left out" if outliers == "exclude" else "left out, since no cell gives that",
            ),
            (outlying & ~missing, deviate, kept),
        )
        return tuple(
            self._named(chosen, subjects, fate) for chosen, subjects, fate in kinds if chosen.any()
        )

    def _named(self, chosen: Mask, subjects: tuple[str, str], fate: str) -> str:
        """Return the places and sizes of outliers in words, the largest first.

        The subjects are of one reading and of several.
        """
        number = self.recording.number
        size = np.where(chosen, np.abs(np.nan_to_num(self.deviation)), -1.0)
        count = int(chosen.sum())
        places = []
        for place in np.argsort(-size, axis=None, kind="stable")[:count].tolist():
            frame, row, column = np.unravel_index(place, chosen.shape)
            named = frame if number is None else number[frame]
            percent = 100 * self.deviation[frame, row, column]
            size_text = f" by {percent:+.2g} %" if np.isfinite(percent) else ""
            places.append(f"row {row}, column {column} of frame {named}{size_text}")
        return f"{count} {subjects[count > 1]}: {first_and_more(places)}; {fate}"
