"""The live learner: k(s) while the beam is being pushed, updated with every frame."""
