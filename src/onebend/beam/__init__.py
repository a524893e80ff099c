"""Pure mechanics of a planar slender beam, on arrays: no file, no camera, no estimation."""
