"""The virtual film: scene, camera, rendering, and the recording folder with its truth."""
