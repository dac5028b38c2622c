"""Uncertainty of an estimate.

It consists of errors of log r due to the noise of the readings and the bias of the penalties.
"""
