"""The paper's figures and its table from shipped recordings, beside the published numbers."""
