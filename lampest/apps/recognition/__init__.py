"""Recognition of loads by shapes with few parameters.

The shapes are fitted to frames and compared by their evidence.
"""
