"""What real benches do beyond the ideal beam, sensor and camera."""
