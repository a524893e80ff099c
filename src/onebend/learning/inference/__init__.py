"""How the parameters are inferred: linear algebra, optimizer, hyperparameters, and the prior of k(s)."""
