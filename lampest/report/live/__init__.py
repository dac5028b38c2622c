"""Live estimation: frames as they arrive, shown on a page in the browser and published for other programs."""
