"""When contacts end: by the swing of a beam that was let go, or as its bending goes to zero."""
