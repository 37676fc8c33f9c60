"""Live inversion: p and q while the finger slides, with a fixed delay."""
