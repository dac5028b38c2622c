"""From the board to the file: protocol (no I/O), port (the serial door), stream, journal, record."""
