"""From corners in pixels to poses of the tags in metres and radians, with covariance."""
