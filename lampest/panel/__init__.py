"""The panel and its circuit: numbering, scene, network of cells, readout electronics."""
