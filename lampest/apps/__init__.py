"""Applications of the core: each folder answers one question and can be deleted."""
