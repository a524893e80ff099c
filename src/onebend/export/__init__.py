"""The learned beam for other software: simulators, robots' descriptions, tables, and a function without us."""
