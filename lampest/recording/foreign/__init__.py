"""Other programs' files as recordings: CSV, .npy, .mat."""
