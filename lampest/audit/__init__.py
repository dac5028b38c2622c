"""What recordings say about scenes.

This is the verdict on the circuit, effects, the health of the panel, and advice.
"""
