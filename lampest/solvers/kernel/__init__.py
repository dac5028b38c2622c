"""A frame after another one in one call of machine code, where nothing is unusual."""
