"""Simulated recordings: loads on a panel, their course, electronics, effects outside the scene."""

from lampest.recording.simulation.file import read_simulations, run
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Cells, Course, Simulation, simulate

__all__ = ["Cells", "Course", "Simulation", "Unmodelled", "read_simulations", "run", "simulate"]
