"""Recognition of loads: shapes with few parameters, fitted to frames and compared by their evidence."""
