"""Methods of estimation: estimators, choice of weights, frame streams, whole recordings, checks."""
