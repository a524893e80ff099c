"""Finding AprilTags in pictures and following them through a film."""
