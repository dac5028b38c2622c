"""Estimators for microcontrollers.

Constants of the C library `lampest_estimate`, and what its budget buys.
"""
