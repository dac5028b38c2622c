"""Frames as they come → cells → a page in the browser: newest (never lag), engine (solve), feed (frames), server."""
