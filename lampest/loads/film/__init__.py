"""What a film remembers: hysteresis and creep as operators over the frames, forwards and backwards."""
