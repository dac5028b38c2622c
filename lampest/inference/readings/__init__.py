"""Which readings are wrong: outliers, garbled and repeated lines, frozen cells, order of lines."""
