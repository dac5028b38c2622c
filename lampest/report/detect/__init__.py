"""Recognition over a recording: what its results show frame by frame, and the events that follow."""
