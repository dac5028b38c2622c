"""A whole recording's frames estimated together."""
