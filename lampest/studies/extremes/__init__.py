"""The atlas of extremes: scenes in which estimates are verified or fail, with the reported reasons."""
