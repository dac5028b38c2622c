"""Check of a recording's circuit, as a case of its own that all estimators of the recording share.

No estimate waits for the check. The cases' folder keeps its outcome, and the results of every
estimator contain it. A recording that has not changed is not checked again.
"""

import json
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from lampest.files.errors import InputError
from lampest.files.whole import inner_folder, write_whole
from lampest.runs.case import StoredCase
from lampest.runs.provenance import digest, library_versions

if TYPE_CHECKING:
    from lampest.audit.advice import Audit

Checks = Literal["all", "none"]
NOT_CHECKED = "not checked"
KEPT = "check/1"
CASES = "cases"  # folder of a run's output, for the files of its cases and checks
SUFFIX = ".check.json"


@dataclass(frozen=True)
class RecordingCheck:
    """Outcome of a check, in words.

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
    """

    mark: str
    sentence: str
    advice: str
    warnings: str
    without: str

    @classmethod
    def of(cls, audit: "Audit") -> "RecordingCheck":
        """Check a recording. Raises InputError where its readings contradict the scene."""
        prepared = audit.prepared
        return cls(
            audit.verdict.mark,
            audit.verdict.sentence,
            "\n".join(audit.lines),
            "\n".join(prepared.warnings),
            "\n".join(prepared.warnings_without_check),
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

    def kept(self) -> RecordingCheck | None:
        """Return the outcome of an earlier run; None without one by this version of lampest."""
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            content = json.loads(self.file.read_text(encoding="utf-8"))
            if content.pop("about") == self._about:
                texts = [content[part.name] for part in fields(RecordingCheck)]
                if all(isinstance(text, str) for text in texts):
                    return RecordingCheck(*texts)
        return None

    def keep(self, check: RecordingCheck) -> None:
        """Write the outcome atomically. Raises InputError where the place cannot be written."""
        check_folder(self.folder)
        write_whole(self.file, json.dumps({"about": self._about} | asdict(check), indent=1) + "\n")

    @property
    def _about(self) -> dict[str, str]:
        return {"format": KEPT, "sha256": self.sha256} | library_versions()


def check_folder(cases: Path) -> None:
    """Raise InputError where the folder of cases, which the run made, is gone or a link."""
    if not inner_folder(cases.parent, cases.name).is_dir():
        raise InputError(
            f"{cases.parent}: was moved, removed or covered while the run went on; "
            "results that were finished are where it is now"
        )


def kept_check(path: Path) -> RecordingCheck | None:
    """Return the check of a recording that a run has kept; None without one.

    Runs are looked for in `results` of the current folder and of the recording's, where they
    write by default.
    """
    for parent in {Path.cwd(), path.parent.resolve()}:
        for folder in sorted(parent.glob(f"results/*/{CASES}")):
            if any(folder.glob(f"*{SUFFIX}")):
                check = CheckTask(path, digest(path), path.stem, folder).kept()
                if check is not None:
                    return check
    return None


def without_check(case: StoredCase) -> StoredCase:
    """Return a case of a run that leaves the check out."""
    sentence = "the circuit was not checked: the run leaves it out"
    warnings = "\n".join(filter(None, [*case.warnings.split("\n"), sentence]))
    return replace(case, verdict=(NOT_CHECKED, sentence), advice="", warnings=warnings)
