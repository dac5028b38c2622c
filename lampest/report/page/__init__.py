"""One page about a batch: what each estimator made of each recording, which to take, and how sure that is."""
