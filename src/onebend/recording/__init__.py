"""Files to observations: pixels, clocks, sensors. Knows no mechanics."""
