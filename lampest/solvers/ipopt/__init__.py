"""IPOPT on formulations that keep node voltages as decision variables."""
