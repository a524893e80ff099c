"""What a real beam and a real bench also do: groups of parameters with priors, one module each."""
