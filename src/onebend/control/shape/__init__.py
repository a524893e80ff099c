"""Forces, or poses of a gripper, that bring a beam as close as it can be to a wanted shape."""
