"""The nonlinear program of a frame, with node voltages as unknowns, and IPOPT, which solves it.

`program` states the program, in one function `pose`. The excitation patterns stand in `patterns`,
the nodes and branches in `circuit`, and the door to IPOPT in `ipopt`. Whatever a scene or a cost
contains enters through these symbols; nothing here knows another solver.
"""
