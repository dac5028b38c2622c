"""Estimators for microcontrollers: constants of the C library `lampest_estimate`, and what its budget buys."""
