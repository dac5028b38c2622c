"""Minimisation: projected Newton, IPOPT, and the choice of starts.

IPOPT has node voltages as unknowns.
"""
