"""Films that remember, the zero of their pressures, and pressures with intervals."""
