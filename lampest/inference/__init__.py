"""Inference of circuit, noise and effects from a recording, before cells are estimated."""
