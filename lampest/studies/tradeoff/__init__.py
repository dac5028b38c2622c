"""What every saved millisecond costs in accuracy: the ladder of formulations, measured side by side."""
