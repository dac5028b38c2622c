"""Projected, damped Newton in log r with potentials eliminated."""
