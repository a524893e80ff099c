"""Goals in time to forces, or poses of a gripper, in time."""
