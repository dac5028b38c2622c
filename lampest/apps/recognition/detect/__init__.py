"""Recognition of loads in recordings: attachments, events, and figures of pressed cells."""
