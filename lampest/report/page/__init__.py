"""Report page of a batch: results of each estimator and recording, a recommendation, and its uncertainty."""
