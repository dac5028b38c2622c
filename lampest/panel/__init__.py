"""Panel and circuit: numbering of cells, scene, network of cells, readout electronics."""
