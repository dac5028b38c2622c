"""Simulated recordings: loads on a panel, their course, the electronics, and what the estimator is not told."""

from lampest.recording.simulation.files import read_simulations, run
from lampest.recording.simulation.simulation import Simulation, simulate

__all__ = ["Simulation", "read_simulations", "run", "simulate"]
