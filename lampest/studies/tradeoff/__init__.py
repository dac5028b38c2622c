"""What every saved millisecond costs in accuracy: the ladder of efforts, measured side by side."""
