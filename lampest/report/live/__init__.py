"""Frames as they come → cells → a page in the browser, and messages for other programs."""
