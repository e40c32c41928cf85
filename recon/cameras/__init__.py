"""Photos, scale and cameras: reading, marker mat, coin, structure from motion, bundle adjustment."""
