"""Recording from boards.

It consists of protocol (without I/O), serial port, stream of frames, journal, and record.
"""
