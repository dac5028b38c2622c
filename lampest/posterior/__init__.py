"""Uncertainty of an estimate.

Errors of log r are due to the noise of the readings and to the bias of the penalties.
"""
