"""The film's own response from known loads: the curve that all cells share, and each cell's gain."""
