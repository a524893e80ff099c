"""When contacts begin and end: by the force that frames show, and by the swing of a beam that was let go."""
