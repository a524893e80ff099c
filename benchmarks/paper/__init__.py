"""The paper's experiments on virtual beams: films, learning, tables, figures, tasks (docs/reproduce.md)."""
