"""Batches: the cases of a run file, their executors and their results."""
