"""The atlas of extremes: where estimates are verified, where they fail, and what is said then."""
