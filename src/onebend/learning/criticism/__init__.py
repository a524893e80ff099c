"""Does the fit's own model hold? Score tests against alternatives."""
