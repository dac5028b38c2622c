"""Report page of a batch.

It has results of each estimator and recording, a recommendation, and its uncertainty.
"""
