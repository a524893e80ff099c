"""k(s) while the beam is being pushed: the posterior, renewed with every frame."""
