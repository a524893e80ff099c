"""Where the pictures show the tool that pushes."""
