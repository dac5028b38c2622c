"""Tables, detections, pictures and pages of results."""
