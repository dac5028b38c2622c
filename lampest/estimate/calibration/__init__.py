"""Calibration: numbers of the circuit or of the film, estimated from recordings of known resistors or loads."""
