"""Loads on a panel in one frame: shapes of a few numbers, fitted and compared."""
