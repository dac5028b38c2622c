"""Results files: what estimators made of recordings, case by case; their one reader and writer."""

from lampest.runs.case import CaseResult, check_name
from lampest.runs.published import PublishedFigures, StepFigures
from lampest.runs.results.kept import read_kept, write_kept
from lampest.runs.results.reader import Results, read_case_ids, read_results
from lampest.runs.results.writer import FORMAT, write_results

__all__ = [
    "FORMAT",
    "CaseResult",
    "PublishedFigures",
    "Results",
    "StepFigures",
    "check_name",
    "read_case_ids",
    "read_kept",
    "read_results",
    "write_kept",
    "write_results",
]
