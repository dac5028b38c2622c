"""Check of a recording's circuit, as a case of its own that all estimators of the recording share.

No estimate waits for the check. The cases' folder keeps its outcome, and the results of every
estimator contain it. A file beside the recording keeps it for all commands, where the folder can be
written. A recording that has not changed is not checked again.
"""

import json
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from lampest.files.errors import InputError
from lampest.files.whole import inner_folder, remove_own, write_whole
from lampest.inference.estimated import estimated_lines
from lampest.runs.case import StoredCase
from lampest.runs.provenance import code_digest, library_versions

if TYPE_CHECKING:
    from lampest.audit.advice import Audit

NOT_CHECKED = "not checked"
KEPT = "check/1"
CASES = "cases"  # folder of a run's output, for the files of its cases and checks
SUFFIX = ".check.json"
BESIDE = ".lampest-check.json"  # in place of the recording's suffix


@dataclass(frozen=True)
class RecordingCheck:
    """Outcome of a check, in words, with what it found about the recording on its way.

    Attributes
    ----------
    mark : str
        'yes', 'doubtful' or 'no'.
    sentence : str
        The verdict on the circuit.
    advice : str
        What the recording suggests beyond its scene, one line each.
    warnings : str
        Warnings of the recording, one line each.
    without : str
        Its warnings without the check, one line each.
    widths : str
        Widths of error bars by their causes, one line each.
    health : str
        Table of health, one line a room.
    noise : str
        Noise of the frames.
    estimated : str
        Numbers that the scene leaves to the recording, one line each.
    """

    mark: str
    sentence: str
    advice: str
    warnings: str
    without: str
    widths: str
    health: str
    noise: str
    estimated: str

    @classmethod
    def of(cls, audit: "Audit") -> "RecordingCheck":
        """Check a recording. Raises InputError where its readings contradict the scene."""
        from lampest.audit.widths import widths_of  # with a fit, which a kept check does without

        prepared = audit.prepared
        return cls(
            audit.verdict.mark,
            audit.verdict.sentence,
            "\n".join(audit.lines),
            "\n".join(prepared.warnings),
            "\n".join(prepared.warnings_without_check),
            "\n".join(width.sentence for width in widths_of(prepared)),
            "\n".join(audit.health.lines),
            prepared.frame_noise.summary,
            "\n".join(estimated_lines(prepared.noise.estimated)),
        )

    def apply_to(self, case: StoredCase) -> StoredCase:
        """Return a case with this check."""
        own = [line for line in case.warnings.split("\n") if line not in self.without.split("\n")]
        warnings = "\n".join(filter(None, [*own, *self.warnings.split("\n")]))
        verdict = (self.mark, self.sentence)
        return replace(case, verdict=verdict, advice=self.advice, warnings=warnings)


@dataclass(frozen=True)
class CheckTask:
    """A recording to check, and the folder of the cases that keeps the outcome.

    Attributes
    ----------
    path : Path
        File of the recording.
    sha256 : str
        Digest of this file, which has the readings and the scene.
    recording : str
    folder : Path
    """

    path: Path
    sha256: str
    recording: str
    folder: Path

    @property
    def file(self) -> Path:
        """File of the outcome."""
        return self.folder / f"{self.sha256[:16]}{SUFFIX}"

    @property
    def beside(self) -> Path:
        """File of the outcome beside the recording, which every command reads."""
        return self.path.with_suffix(BESIDE)

    def kept(self) -> RecordingCheck | None:
        """Return the outcome of an earlier command; None without one by this code of lampest."""
        return _read(self.file, self.sha256) or _read(self.beside, self.sha256)

    def keep(self, check: RecordingCheck) -> None:
        """Write the outcome atomically. Raises InputError where the place cannot be written."""
        check_folder(self.folder)
        _write(self.file, self.sha256, check)
        keep_beside(self.path, self.sha256, check)

    def forget(self) -> None:
        """Remove the outcome, beside the recording as far as that place can be written."""
        remove_own(self.file)
        with suppress(OSError):
            remove_own(self.beside)


def _read(file: Path, sha256: str) -> RecordingCheck | None:
    """Return the kept check of a recording; None for a damaged file and one about another state."""
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
        content = json.loads(file.read_text(encoding="utf-8"))
        if content.pop("about") == _about(sha256):
            texts = [content[part.name] for part in fields(RecordingCheck)]
            if all(isinstance(text, str) for text in texts):
                return RecordingCheck(*texts)
    return None


def _write(file: Path, sha256: str, check: RecordingCheck) -> None:
    """Write a check atomically. Raises InputError where the place cannot be written."""
    write_whole(file, json.dumps({"about": _about(sha256)} | asdict(check), indent=1) + "\n")


def _about(sha256: str) -> dict[str, str]:
    """Return what a check follows from: the recording with its scene, and the code."""
    return {"format": KEPT, "sha256": sha256, "code": code_digest()} | library_versions()


def keep_beside(path: Path, sha256: str, check: RecordingCheck) -> None:
    """Write a check beside its recording; a place that cannot be written gets none."""
    with suppress(InputError):
        _write(path.with_suffix(BESIDE), sha256, check)


def check_folder(cases: Path) -> None:
    """Raise InputError where the folder of cases, which the run made, is gone or a link."""
    if not inner_folder(cases.parent, cases.name).is_dir():
        raise InputError(
            f"{cases.parent}: was moved, removed or covered while the run went on; "
            "results that were finished are where it is now"
        )


def kept_check(path: Path, sha256: str) -> RecordingCheck | None:
    """Return the check of a recording with this digest that a command has kept; None without one.

    It stands beside the recording. Where that place cannot be written, runs are looked for in
    `results` of the current folder and of the recording's, where they write by default.
    """
    for parent in dict.fromkeys((path.parent.resolve(), Path.cwd())):
        for folder in (parent, *sorted(parent.glob(f"results/*/{CASES}"))):
            if check := CheckTask(path, sha256, path.stem, folder).kept():
                return check
    return None


def without_check(case: StoredCase) -> StoredCase:
    """Return a case of a run that leaves the check out."""
    sentence = "the circuit was not checked: the run leaves it out"
    warnings = "\n".join(filter(None, [*case.warnings.split("\n"), sentence]))
    return replace(case, verdict=(NOT_CHECKED, sentence), advice="", warnings=warnings)
