"""What repeats and neighbours in time say of the noise: its size, what a frame or a scanned line shares, outliers."""
