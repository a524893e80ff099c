"""The offset between the film's clock and the force log's, with its posterior."""
