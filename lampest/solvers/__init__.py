"""Minimisation: projected Newton, IPOPT with node voltages as unknowns, regions, and which start is taken."""
