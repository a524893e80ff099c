"""What to do to a beam of known stiffness so that it goes where it is wanted."""
