"""What presses or sucks on a panel in one frame: loads of a few numbers, fitted and compared."""
