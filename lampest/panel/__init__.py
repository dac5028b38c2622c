"""The panel and its circuit: numbering, what a scene names, the network of cells, the electronics that read it."""
