"""Batches: a run's file as cases, their results, and where they are solved."""
