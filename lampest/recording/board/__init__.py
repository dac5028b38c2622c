"""Recording from boards: protocol (without I/O), serial port, stream of frames, journal, and record."""
