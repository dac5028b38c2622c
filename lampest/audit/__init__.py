"""Audit of scenes by their recordings.

An audit has the verdict on the circuit, effects, the health of the panel, and advice.
"""
