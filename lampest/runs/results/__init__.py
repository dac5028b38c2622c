"""Results files: what estimators made of recordings, case by case; their one reader and writer."""

from lampest.runs.case import CaseResult, StoredCase, check_name
from lampest.runs.results.reader import Results, read_each, read_results, stored_cases
from lampest.runs.results.writer import FORMAT, PublishedFigures, StepFigures, join_case, write_results

__all__ = [
    "FORMAT",
    "CaseResult",
    "PublishedFigures",
    "Results",
    "StepFigures",
    "StoredCase",
    "check_name",
    "join_case",
    "read_each",
    "read_results",
    "stored_cases",
    "write_results",
]
