"""Studies of lampest itself: timings, trade-offs, extremes, starts, weights; each with its figure."""
