"""Only what changed is unknown."""
