"""Studies of solvers and estimators: timings, trade-offs, extremes, weights, the paper."""
