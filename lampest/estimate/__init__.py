"""Methods of estimation: estimators, choice of weights, streams of frames, whole recordings, checks."""
