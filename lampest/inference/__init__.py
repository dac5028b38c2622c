"""Inference of circuit, noise and effects from a recording, before cells are estimated.

One observation model is behind all of it. Readings of frame f under cells x, with errors z that
frames share and numbers θ that a scene may state, are

    y_f = h(x_f; θ) + U_f z + noise,   z ~ N(0, prior²).

Linearised about the fits of the unloaded panel b and of f, log cells change by

    d = A z + noise,   A = K_f U_f − K_b U_b.

A cell stands still, d ~ N(0, creep²), or moved, d ~ N(0, 1), with odds of four to one (spike and
slab). From this one statement follow the numbers that a scene calls `estimated`, the doubts of its
circuit, and advice:

| module | part of the statement |
|---|---|
| `lampest.panel.effects` | U and the prior of each z |
| `effects` | θ of effects that need a search of their own |
| `cells_fit` | x of one frame, K and the covariance of its log cells |
| `pair` | d, A and the covariance of two frames |
| `evidence` | the moved cells, the evidence of d, the posterior of z |
| `number` | the posterior of a θ by its evidence on a grid |
| `shared_changes`, `unloaded_cells` | the posterior of the sizes of errors that all frames share |
| `circuits` | other h, and the one that explains the frames better |
| `readings` | y without outliers, frozen and garbled readings |
| `resolve` | the numbers of a scene |

`lampest.posterior.gaussian` has the posterior of a Gaussian unknown by linear readings.
"""
