"""Import of other programs' files as recordings: text tables, sheets, and arrays."""
