"""What recordings say about scenes: the verdict on the circuit, effects, the health of the panel, and advice."""
