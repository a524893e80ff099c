"""What a beam is wanted to do: target shapes, goals that move, and the files they come from."""
