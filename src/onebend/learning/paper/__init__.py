"""The paper's own method: inverse kinematics (22), regression (12)-(18), selection (19)-(20)."""
