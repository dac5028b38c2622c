"""Inference of circuit, noise and effects from a recording, before cells are estimated.

One observation model is behind all of it. Readings of frame f under cells x, with errors z that
frames share and numbers θ that a scene may state, are

    y_f = h(x_f; θ) + U_f z + noise,   z ~ N(0, prior²).

Linearised about the fits of the unloaded panel b and of f, log cells change by

    d = A z + noise,   A = K_f U_f − K_b U_b,

where a cell stands still, d ~ N(0, creep²), or moved, d ~ N(0, 1). `changed_cells` has the evidence
of d and the posterior of z, `fitted_pair` d and A of two frames, `effects` the θ and U of each
effect, `rivals` other h, and `lampest.posterior.gaussian` the posterior of a Gaussian unknown.
"""
