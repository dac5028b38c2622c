"""How long solvers take, side by side in one process: reduced, nodal and scipy's, and what accuracy they reach."""
