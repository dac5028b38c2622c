"""Whether a scene's circuit can explain a recording's readings, and which other circuit explains them better."""
