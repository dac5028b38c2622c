"""Where error bars hold: a table of effects that no scene tells, by estimator."""
