"""A PyBullet world that stands in for arm, hand and camera."""
