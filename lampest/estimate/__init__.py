"""Methods of estimation: estimator, weights left to the data, frames as they come, frames of a recording."""
