"""The cost function: terms, losses, what a term is given, the compiled cost, the estimation problem."""
