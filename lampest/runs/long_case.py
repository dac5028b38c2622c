"""A case of a recording too long for memory: its parts are files of their own until the last of them is done."""

from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.prepared import Prepared
from lampest.estimate.sequence import Parts, asked_frames
from lampest.estimate.state import CarriedOver
from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.whole import inner_folder, remove_own
from lampest.recording.recording import Recording
from lampest.recording.stored import StoredRecording
from lampest.runs.case import StoredCase
from lampest.runs.config import Case
from lampest.runs.filling import case_result
from lampest.runs.results import join_case, stored_cases, write_results

CARRIED = "carried/1"


@dataclass(frozen=True)
class PartFiles:
    """folder : of the parts; each is a results file, and beside it stands what the frames behind it need of it."""

    case: Case
    folder: Path

    @classmethod
    def beside(cls, case: Case, file: Path) -> "PartFiles":
        """Of a case whose result will be that file. Raises InputError where the folder is a link that leads out."""
        return cls(case, inner_folder(file.parent, f"{file.stem}.parts"))

    def results(self, number: int) -> Path:
        """Return the estimates of a part."""
        return self.folder / f"{number:06d}.h5"

    def carried(self, number: int) -> Path:
        """Return what the next part needs of it; it is there before the estimates are."""
        return self.folder / f"{number:06d}_carried.h5"

    def done(self, number: int) -> CarriedOver | None:
        """Return what a part left, None where it is not whole: then it is solved again."""
        with suppress(InputError):
            if self.results(number).is_file() and self.carried(number).is_file():
                hdf5.checked(self.results(number))
                [held] = stored_cases(self.results(number))
                if held.case_id == self.case.case_id:
                    return read_carried(self.carried(number))
        return None

    def write(self, number: int, estimates: Estimates, carried: CarriedOver) -> int:
        """Keep a part's estimates, and what the next part needs; the part's number."""
        write_carried(self.carried(number), carried)
        write_results(self.results(number), [case_result(self.case, estimates)])
        return number

    @property
    def whole(self) -> list[int]:
        """Numbers of the parts whose estimates are there."""
        return sorted(int(file.stem) for file in self.folder.glob("[0-9]" * 6 + ".h5"))

    def clear(self) -> None:
        """Remove all that a case leaves here, and nothing else."""
        for pattern in ("*.h5", ".*.h5.*.part"):
            for file in self.folder.glob(pattern):
                remove_own(file)
        with suppress(OSError):
            self.folder.rmdir()


def solve_long(case: Case, stored: StoredRecording, file: Path) -> StoredCase:
    """Solve a case part by part, from the first one on that is not done, and write its result, whole or not at all."""
    files, solved = PartFiles.beside(case, file), list[int]()
    if case.estimator.uses_previous or not set(stored.measured_blocks) <= set(files.whole):
        parts = _parts(case.estimator, stored)
        # What stands behind a part that is solved now followed from another one, unless parts stand apart.
        for part in parts.estimates(lambda at: None if solved and not parts.independent else files.done(at)):
            solved.append(files.write(*part))
    join_case(file, [files.results(number) for number in files.whole], case.recording)
    files.clear()
    return next(held for held in stored_cases(file) if held.case_id == case.case_id)


def parts_to_solve(case: Case, stored: StoredRecording, file: Path) -> list[int]:
    """Return the numbers of the parts of a case that may be solved in any order, and are not done.

    A damaged one goes.
    """
    files = PartFiles.beside(case, file)
    every = () if case.estimator.uses_previous else stored.measured_blocks
    waiting = [number for number in every if files.done(number) is None]
    for number in waiting:
        remove_own(files.results(number))
    return waiting


def solve_part(case: Case, stored: StoredRecording, file: Path, number: int) -> None:
    """Solve one of these, where that is possible without those before."""
    for part in _parts(case.estimator, stored).solve_part(number):
        PartFiles.beside(case, file).write(*part)


@lru_cache(maxsize=1)  # a process solves several parts of a case
def _parts(estimator: Estimator, stored: StoredRecording) -> Parts:
    return Parts.of(stored, estimator, _asked(stored))


@lru_cache(maxsize=1)  # several estimators of one recording come one after the other
def _asked(stored: StoredRecording) -> tuple[Recording, Prepared]:
    return asked_frames(stored)


def write_carried(path: Path, carried: CarriedOver) -> None:
    """Write what a part leaves, whole or not at all. Raises InputError where the place cannot be written."""
    with hdf5.new_file(path) as file:
        hdf5.set_attributes(file, lampest_format=CARRIED)
        group = file.create_group("carried")
        for name, values in carried.arrays.items():
            unit = "ohm" if name.endswith("previous") else "1"
            hdf5.write_dataset(group, name, values, unit, name.replace("_", " "))


def read_carried(path: Path) -> CarriedOver:
    """Return what a part left. Raises InputError where it cannot be read."""
    with hdf5.existing_file(path) as file:
        if hdf5.read_attribute(file, "/", "lampest_format") != CARRIED:
            raise InputError(f"{path}: is not the remainder of a part of a case")
        names = hdf5.child_datasets(file, "/carried")
        return CarriedOver({name: hdf5.read_array(file, f"/carried/{name}", (1, 2)) for name in names})


def frames_of_parts(case: Case, stored: StoredRecording, file: Path) -> int:
    """Return the number of frames of the parts that are whole; one in which no frame is measured has no file."""
    return min(stored.frames, len(PartFiles(case, file.with_suffix(".parts")).whole) * stored.length)
