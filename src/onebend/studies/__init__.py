"""The paper's experiments made again, from films to tables and figures."""
