"""Minimisation: projected Newton, IPOPT with node voltages as unknowns, and the choice of starts."""
