"""The cost function: terms, losses, given inputs, the compiled cost, the estimation problem."""
