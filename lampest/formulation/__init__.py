"""The nonlinear program of a frame, with node voltages as unknowns, and IPOPT, which solves it.

The program stands in `program`, the excitation patterns in `patterns`, the nodes and branches in
`circuit`, and the door to IPOPT in `ipopt`. Whatever a scene or a cost contains enters through
these symbols; nothing here knows another solver.
"""
