"""Natural frequencies in the fit: measured ones, what the parameters predict, and where the fit may begin."""
